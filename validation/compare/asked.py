"""Engines that a comparison is asked for, and whether those that had to run did."""

import sys
from collections.abc import Iterable
from dataclasses import dataclass

from drivers.base.errors import one_line
from drivers.engines import REFERENCE, VERLET, codes, engine_names, installed_codes, load_engine, missing_codes


@dataclass(frozen=True)
class Asked:
    """Engines that a comparison is asked for.

    Attributes:
        engines: those to compare, beside the two yardsticks; empty for all.
        require: engines that have to run, as those of ``engines`` have to.
        allow_missing: whether only those of ``require`` have to run, and no established code.
    """

    engines: tuple[str, ...] = ()
    require: tuple[str, ...] = ()
    allow_missing: bool = False

    @property
    def names(self) -> list[str]:
        """All engines to compare."""
        some = {*self.engines, *self.require, VERLET, REFERENCE}
        return [name for name in engine_names() if not self.engines or name in some]

    @property
    def builds(self) -> list[tuple[str, str]]:
        """Engines that are named and have one adapter: each with the first of them."""
        first: dict[str, str] = {}
        pairs = ((first.setdefault(load_engine(name).entry.adapter, name), name) for name in self.engines)
        return [(one, other) for one, other in pairs if one != other]

    def unmet(self, ran: Iterable[str]) -> dict[str, str]:
        """Requirements that are not met, in words by engine, where some engines ran, well or badly."""
        there = set(ran)
        needed = dict.fromkeys([*self.require, *(() if self.allow_missing else self.engines)])
        words = {name: f"{name} is required and did not run: {_why_not(name)}" for name in needed if name not in there}
        if not (words or self.allow_missing or there & set(codes())):
            missing = ", ".join(f"{name} ({load_engine(name).how_to_get})" for name in missing_codes())
            how = "" if installed_codes() else f": install one of {missing}"
            words["codes"] = f"no established code ran{how}; --allow-missing lets that pass"
        return words


EVERYTHING = Asked()


def _why_not(engine: str) -> str:
    found = load_engine(engine)
    return "there is nothing of it to compare" if found.find() else found.absence


def print_unmet(unmet: dict[str, str]) -> bool:
    """Prints the requirements that are not met, if any, in one line; whether there are any."""
    if unmet:
        print(one_line("; ".join(unmet.values())), file=sys.stderr)
    return bool(unmet)
