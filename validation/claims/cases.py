"""Cases beyond the paper, ``inputs/independent.toml``: scenes whose numbers are published or follow from a theory.

To add a measure, write its two functions and a line in ``MEASURES``.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Annotated

from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import shorten
from drivers.batch.study import read_study, seen_from
from drivers.chain.case import Case
from drivers.chain.trace import Trace
from drivers.scene.model import Name, Part
from drivers.scene.read_scene import apply_setting, read_entries
from validation.accuracy.plan import plan_case, planned_case
from validation.claims.measures import (
    bands,
    driven,
    impact,
    linear,
    passing_waves,
    precompressed,
    solitary,
    unequal,
    weak,
)

UNITS = {"_m_s": "m/s", "_N": "N", "_Hz": "Hz", "_s": "s", "_m": "m", "_rad": "rad", "_diameters": "diameters"}


@dataclass(frozen=True)
class Measure:
    """Two pure functions of a case; names of quantities end with their unit, if they have one.

    Attributes:
        measure: quantities read from a run; ValueError if the run does not show them, for example without a wave.
        theory: quantities by a closed form or an independent solver, as far as the theory goes; ValueError if it does
            not apply to the case.
        quantities: description of each quantity, by name.
        source: source of the theory.
    """

    measure: Callable[[Case, Trace], dict[str, float]]
    theory: Callable[[Case], dict[str, float]]
    quantities: dict[str, str]
    source: str


MEASURES = {
    "bands": Measure(bands.measure, bands.theory, bands.QUANTITIES, bands.SOURCE),
    "collision": Measure(
        passing_waves.collision,
        passing_waves.collision_theory,
        passing_waves.COLLISION,
        "the exact solitary wave, integrated by scipy's DOP853 up to a wall in place of the other half",
    ),
    "decorated chain": Measure(
        unequal.decorated,
        unequal.decorated_theory,
        unequal.DECORATED,
        "the exact wave of the effective chain: mass M + m, stiffness k / 2^(3/2)",
    ),
    "driven": Measure(driven.measure, driven.theory, driven.QUANTITIES, driven.SOURCE),
    "impact": Measure(impact.measure, impact.theory, impact.QUANTITIES, impact.SOURCE),
    "impurity": Measure(
        unequal.impurity, unequal.impurity_theory, unequal.IMPURITY, "modes of the linearised finite chain"
    ),
    "precompressed wave": Measure(
        precompressed.measure, precompressed.theory, precompressed.QUANTITIES, precompressed.SOURCE
    ),
    "small signal": Measure(linear.measure, linear.theory, linear.QUANTITIES, linear.SOURCE),
    "solitary wave": Measure(solitary.measure, solitary.theory, solitary.QUANTITIES, solitary.SOURCE),
    "taper": Measure(unequal.taper, unequal.taper_theory, unequal.TAPER, "binary collisions, 2/(1 + m_(k+1)/m_k)"),
    "train": Measure(
        passing_waves.train,
        passing_waves.train_theory,
        passing_waves.TRAIN,
        "the same chain by scipy's DOP853 with a tolerance of 1e-10 per step",
    ),
    "wall": Measure(
        passing_waves.reflection,
        passing_waves.reflection_theory,
        passing_waves.WALL,
        "the exact solitary wave of the discrete chain, integrated by scipy's DOP853 up to the wall",
    ),
    "weak strike": Measure(weak.measure, weak.theory, weak.QUANTITIES, weak.SOURCE),
}


def unit_of(quantity: str) -> str:
    """The unit at the end of a quantity's name; empty where it is a plain number."""
    return next((unit for ending, unit in UNITS.items() if quantity.endswith(ending)), "")


Words = Annotated[str, Field(min_length=1)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Limit = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Expectation(Part):
    """Expected number of a case; the head of the file explains the keys."""

    quantity: Words
    expected: Number | None = None
    within: Limit | None = None
    absolute: Limit | None = None
    reason: Words

    @property
    def limit(self) -> float:
        """Allowed error."""
        return self.within or self.absolute or nan  # read_independent refuses a check without either

    @property
    def against(self) -> str:
        """Origin of the expected value: ``theory`` or ``quoted``."""
        return "theory" if self.expected is None else "quoted"

    def error(self, value: float, expected: float) -> float:
        """Error of a number, relative or absolute like the limit."""
        off = abs(value - expected)
        return off / abs(expected) if self.within is not None else off


class Independent(Part):
    """An independent case; the head of the file explains the keys."""

    id: Name
    title: Words
    source: Words
    scene: str | None = None
    study: str | None = None
    set: tuple[str, ...] = Field(default=(), strict=False)
    measure: str
    check: Annotated[tuple[Expectation, ...], Field(strict=False, min_length=1)]


@dataclass(frozen=True, eq=False)
class Posed:
    """A case to be run, of an independent case.

    Attributes:
        entry: the independent case, as in the file.
        label: settings of the case if the entry is a study; empty for a scene.
        theory: quantities by the theory of the measure.
    """

    entry: Independent
    label: str
    case: Case
    theory: dict[str, float]


def read_independent(path: Path = paths.INDEPENDENT) -> tuple[Independent, ...]:
    """Reads the cases of the file.

    Raises:
        InputError: anything in the file is wrong, such as an unknown measure or quantity.
    """
    where = paths.shown(path)
    entries = read_entries(path, "case", Independent)
    counts = Counter(entry.id for entry in entries)
    for entry in entries:
        key = f"case {entry.id}"
        if counts[entry.id] > 1:
            raise InputError(where, key, "id used twice")
        _exactly_one(where, key, entry, "scene", "study")
        if entry.measure not in MEASURES:
            raise InputError(where, f"{key}: measure", shorten(entry.measure), ", ".join(sorted(MEASURES)))
        known = MEASURES[entry.measure].quantities
        same = Counter((expectation.quantity, expectation.against) for expectation in entry.check)
        for check in entry.check:
            place = f"{key}: check {check.quantity}"
            if check.quantity not in known:
                raise InputError(where, f"{key}: check.quantity", shorten(check.quantity), ", ".join(sorted(known)))
            _exactly_one(where, place, check, "within", "absolute")
            if check.expected == 0 and check.within is not None:
                raise InputError(where, place, "within with expected = 0: no error is relative to 0; give absolute")
            if same[check.quantity, check.against] > 1:
                allowed = "each quantity once with expected and once without"
                raise InputError(where, place, "check given twice", allowed)
    return entries


def _exactly_one(where: str, place: str, part: Part, *names: str) -> None:
    given = [name for name in names if getattr(part, name) is not None]
    if not given:
        raise InputError(where, place, f"missing key {' or '.join(names)}")
    if len(given) > 1:
        raise InputError(where, place, f"keys {' and '.join(names)}; give one of them")


def pose(entry: Independent, path: Path = paths.INDEPENDENT) -> list[Posed]:
    """Cases of an entry: its scene, or all cases of its study, with the settings of the entry.

    Raises:
        InputError: a scene, study or setting is wrong, or an expected value is missing and no theory gives it.
    """
    where, key = paths.shown(path), f"case {entry.id}"
    if entry.scene is not None:
        cases = {"": planned_case(seen_from(path, entry.scene), *entry.set)}
    else:
        assert entry.study is not None
        study = read_study(seen_from(path, entry.study))
        for setting in entry.set:
            apply_setting(study.base, setting)
        cases = {study.label(number): plan_case(study.case(number)) for number in range(1, study.count + 1)}
    try:
        posed = [Posed(entry, label, case, MEASURES[entry.measure].theory(case)) for label, case in cases.items()]
    except (ValueError, ArithmeticError) as error:
        raise InputError(where, key, str(error), f'a case for the measure "{entry.measure}"') from error
    for check in entry.check:
        if check.expected is None and any(check.quantity not in posed_case.theory for posed_case in posed):
            raise InputError(where, f"{key}: check {check.quantity}", "missing key expected; no theory gives the value")
    return posed
