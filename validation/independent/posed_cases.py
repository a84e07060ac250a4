"""Reads ``inputs/independent.toml``: cases, the measure that reads each, and what it is checked for.

A further measure is a module or class of the form of ``Measure`` and a line in ``MEASURES``.
"""

from collections import Counter
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Annotated, Protocol

from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import shorten, validate
from drivers.batch.study import read_study, seen_from
from drivers.chain.case import Case
from drivers.chain.trace import Trace
from drivers.scene.model import Name, Part
from drivers.scene.read_scene import lay_over, read_toml
from validation.accuracy.plan import plan_case, planned_case
from validation.independent import impact, linear, solitary, weak
from validation.independent.passing_waves import Collision, Train, Wall

UNITS = (("_m_s", "m/s"), ("_N", "N"), ("_Hz", "Hz"), ("_s", "s"), ("_m", "m"), ("_diameters", "diameters"))


class Measure(Protocol):
    """Two pure functions of a case; names of quantities end with their unit, or have none.

    Attributes:
        QUANTITIES: what each quantity is, in words, by its name.
        SOURCE: where the theory is from.
    """

    QUANTITIES: dict[str, str]
    SOURCE: str

    def measure(self, case: Case, trace: Trace) -> dict[str, float]:
        """The quantities as a run shows them.

        Raises:
            ValueError: the run does not show them, and fails by it: a wave never comes, say.
        """
        ...

    def theory(self, case: Case) -> dict[str, float]:
        """The quantities by a closed form or a solver of its own, as many as it knows.

        Raises:
            ValueError: the case is none of its kind.
        """
        ...


MEASURES: dict[str, Measure] = {
    "collision": Collision(),
    "impact": impact,
    "small signal": linear,
    "solitary wave": solitary,
    "train": Train(),
    "wall": Wall(),
    "weak strike": weak,
}


def unit_of(quantity: str) -> str:
    """The unit at the end of a quantity's name; empty where it is a plain number."""
    return next((unit for ending, unit in UNITS if quantity.endswith(ending)), "")


Words = Annotated[str, Field(min_length=1)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Limit = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Check(Part):
    """One number; see the head of the file for the keys."""

    quantity: Words
    expected: Number | None = None
    within: Limit | None = None
    absolute: Limit | None = None
    reason: Words

    @property
    def limit(self) -> float:
        """The error allowed."""
        return self.within or self.absolute or nan  # read_independent admits no check without

    @property
    def against(self) -> str:
        """What it is compared with."""
        return "theory" if self.expected is None else "quoted"

    def error(self, found: float, expected: float) -> float:
        """By how much a number is off, in the terms of the limit."""
        off = abs(found - expected)
        return off / abs(expected) if self.within is not None else off


class Independent(Part):
    """A case; see the head of the file for the keys."""

    id: Name
    title: Words
    source: Words
    scene: str | None = None
    study: str | None = None
    set: tuple[str, ...] = Field(default=(), strict=False)
    measure: str
    check: Annotated[tuple[Check, ...], Field(strict=False, min_length=1)]


class IndependentFile(Part):
    """The file."""

    case: Annotated[tuple[Independent, ...], Field(strict=False, min_length=1)]


@dataclass(frozen=True)
class Posed:
    """A case of an independent case, ready to be run.

    Attributes:
        entry: as the file has it.
        label: of a case of a study; empty for a scene.
        theory: what the measure's theory gives.
    """

    entry: Independent
    label: str
    case: Case
    theory: dict[str, float]


def read_independent(path: Path = paths.INDEPENDENT) -> tuple[Independent, ...]:
    """The cases of the file.

    Raises:
        InputError: anything wrong with it, a measure or quantity that nothing computes included.
    """
    where = paths.shown(path)
    entries = validate(IndependentFile, read_toml(path), where).case
    counts = Counter(entry.id for entry in entries)
    for entry in entries:
        key = f"case {entry.id}"
        if counts[entry.id] > 1:
            raise InputError(where, key, "the same id twice", "an id of its own for each case")
        if (entry.scene is None) == (entry.study is None):
            found = "neither scene nor study" if entry.scene is None else "a scene and a study"
            raise InputError(where, key, found, "one of them")
        if entry.measure not in MEASURES:
            raise InputError(where, f"{key}: measure", shorten(entry.measure), ", ".join(sorted(MEASURES)))
        known, same = MEASURES[entry.measure].QUANTITIES, Counter((each.quantity, each.against) for each in entry.check)
        for check in entry.check:
            place = f"{key}: check {check.quantity}"
            if check.quantity not in known:
                raise InputError(where, f"{key}: check.quantity", shorten(check.quantity), ", ".join(sorted(known)))
            if (check.within is None) == (check.absolute is None):
                found = "neither within nor absolute" if check.within is None else "within and absolute"
                raise InputError(where, place, found, "one of them")
            if check.expected == 0 and check.within is not None:
                allowed = "absolute, since no error is relative to 0"
                raise InputError(where, place, "within beside expected = 0", allowed)
            if same[check.quantity, check.against] > 1:
                allowed = "each quantity once with expected and once without"
                raise InputError(where, place, "the same check twice", allowed)
    return entries


def pose(entry: Independent, path: Path = paths.INDEPENDENT) -> list[Posed]:
    """The case of an entry's scene, or all of its study, with its settings laid over.

    Raises:
        InputError: a scene, study or setting is wrong, or no theory gives a number that the file leaves out.
    """
    where, key = paths.shown(path), f"case {entry.id}"
    if entry.scene is not None:
        cases = {"": planned_case(seen_from(path, entry.scene), *entry.set)}
    else:
        assert entry.study is not None
        study = read_study(seen_from(path, entry.study))
        for setting in entry.set:
            lay_over(study.base, setting)
        cases = {study.label(number): plan_case(study.case(number)) for number in range(1, study.count + 1)}
    try:
        posed = [Posed(entry, label, case, MEASURES[entry.measure].theory(case)) for label, case in cases.items()]
    except (ValueError, ArithmeticError) as error:
        raise InputError(where, key, str(error), f'a case that the measure "{entry.measure}" can read') from error
    for check in entry.check:
        if check.expected is None and any(check.quantity not in one.theory for one in posed):
            raise InputError(where, f"{key}: check {check.quantity}", "no expected", "a number: no theory gives it")
    return posed
