"""Engines selected for a comparison, and required engines that did not run."""

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from drivers.base.errors import one_line
from drivers.engines import REFERENCE, VERLET, codes, engine_names, installed_codes, load_engine, missing_codes


@dataclass(frozen=True)
class EngineSelection:
    """Engines selected for a comparison.

    Attributes:
        engines: engines to compare, in addition to the baseline and the reference; empty for all. Each has to run.
        require: further engines that have to run.
        allow_missing: True if only the engines of ``require`` have to run.
    """

    engines: tuple[str, ...] = ()
    require: tuple[str, ...] = ()
    allow_missing: bool = False

    @property
    def names(self) -> list[str]:
        """Names of all engines to compare."""
        some = {*self.engines, *self.require, VERLET, REFERENCE}
        return [name for name in engine_names() if not self.engines or name in some]

    @property
    def needed(self) -> list[str]:
        """Names of the engines that have to run."""
        return list(dict.fromkeys([*self.require, *(() if self.allow_missing else self.engines)]))

    def unmet(self, ran: Iterable[str], absent: Mapping[str, str] = MappingProxyType({})) -> dict[str, str]:
        """Messages on unmet requirements, by engine.

        Args:
            ran: engines that ran, including failed runs.
            absent: reason for a missing run, by engine, such as a refusal.
        """
        present = set(ran)
        messages = {name: _did_not_run(name, absent.get(name, "")) for name in self.needed if name not in present}
        if not (messages or self.allow_missing or present & set(codes())):
            missing = ", ".join(f"{name} ({load_engine(name).how_to_get})" for name in missing_codes())
            how = "" if installed_codes() else f": install one of {missing}"
            messages["codes"] = f"no established code ran{how}; use --allow-missing to accept this"
        return messages


ALL_ENGINES = EngineSelection()


def selected(engines: Iterable[str], required: Iterable[str], *, allow_missing: bool) -> EngineSelection:
    """Engines of the options ``--engine`` and ``--require``.

    Raises:
        InputError: an engine is unknown.
    """
    asked = EngineSelection(tuple(engines), tuple(required), allow_missing)
    for option, names in (("--engine", asked.engines), ("--require", asked.require)):
        for name in names:
            load_engine(name, option)
    return asked


def _did_not_run(engine: str, why: str) -> str:
    loaded = load_engine(engine)
    if loaded.find() is None:
        return f"{engine} is required and did not run: {loaded.absence}"
    return f"{engine} did not run: {why}" if why else f"{engine} is required and has no run to compare"


def print_unmet(unmet: dict[str, str]) -> bool:
    """Prints unmet requirements on one line of stderr; returns True if there are any."""
    if unmet:
        print(one_line("; ".join(unmet.values())), file=sys.stderr)
    return bool(unmet)
