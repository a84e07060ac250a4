"""Published numbers as data: statements of the paper, and cases beyond it.

A statement names the function that computes it, ``module.function`` in this folder. A case names a scene or a study and
a measure of ``linear_waves`` or ``strong_waves``.
"""

from collections import Counter
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import shorten, validate
from drivers.batch.study import read_study, seen_from
from drivers.chain.case import Case
from drivers.scene.model import Part
from drivers.scene.read_scene import apply_setting, read_toml
from validation.accuracy.plan import plan_case, planned_case
from validation.claims import chains, equations, linear_waves, strong_waves

# kinds, in the order of the report
PHYSICS, FITTED, CERTAIN, ARITHMETIC, CASE = "physics", "fitted", "certain", "arithmetic", "case"
UNITS = {"_m_s": "m/s", "_N": "N", "_Hz": "Hz", "_s": "s", "_m": "m", "_rad": "rad", "_diameters": "diameters"}

Id = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_.-]*$", max_length=60)]
Words = Annotated[str, Field(min_length=1)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Limit = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Arguments = dict[str, float | str | bool]
Tables = Annotated[tuple[dict[str, Any], ...], Field(strict=False)]


class Reading(Part):
    """One way to read a sentence, or a case of a study.

    Attributes:
        words: the reading, in a few words; empty for a sentence with one meaning.
        arguments: arguments of the claim's function, in addition to those of the claim.
        favoured: reason why this reading is judged; empty for the others.
    """

    words: str = ""
    arguments: Arguments = Field(default_factory=dict)
    favoured: str = ""


Readings = Annotated[tuple[Reading, ...], Field(strict=False, min_length=2)]  # of one sentence


class Claim(Part):
    """A published number; the heads of the files explain the keys.

    Attributes:
        kind: ``case`` for a number of a case beyond the paper.
        expected: the published number; None for that of the measure's theory.
        within, absolute: allowed error, as a share of the expected number or in its unit.
    """

    id: Id
    source: Words
    kind: Literal["physics", "fitted", "certain", "arithmetic", "case"] = CASE
    measure: str = ""
    expected: Number | None = None
    within: Limit | None = None
    absolute: Limit | None = None
    reason: Words
    relation: Literal["equals", "at most", "at least"] = "equals"
    unit: str = ""
    # of a statement
    quote: str = ""
    arguments: Arguments = Field(default_factory=dict)
    how: str = ""
    explained: str = ""
    cause: str = ""
    our_criterion: bool = False
    readings: Annotated[tuple[Reading, ...], Field(strict=False)] = (Reading(favoured="the only one"),)
    shared_readings: str = ""
    # of a case
    title: str = ""
    scene: str | None = None
    study: str | None = None
    set: tuple[str, ...] = Field(default=(), strict=False)
    quantity: str = ""
    file: str = ""

    @property
    def against(self) -> str:
        """Origin of the expected number."""
        return "theory" if self.expected is None else "quoted"

    @property
    def favoured(self) -> Reading:
        """The judged reading."""
        return next(reading for reading in self.readings if reading.favoured)

    @property
    def limit(self) -> float:
        """Allowed error."""
        return self.within or self.absolute or 0.0

    def error(self, value: float, expected: float) -> float:
        """Deviation of a computed value, relative or absolute like the limit; NaN for NaN."""
        off = value - expected
        if self.relation != "equals":
            return max(off if self.relation == "at most" else -off, 0.0)  # of NaN and 0 the first: NaN
        return abs(off) / abs(expected) if self.within else abs(off)


class ClaimsFile(Part):
    """A file of published numbers: rows of a ``group`` are claims with the group's keys, so are checks of a ``case``.

    Attributes:
        measure: source and description of the quantities of each measure of cases.
    """

    readings: dict[str, Readings] = Field(default_factory=dict)
    causes: dict[str, str] = Field(default_factory=dict)
    measure: dict[str, dict[str, str]] = Field(default_factory=dict)
    claim: Tables = ()
    group: Tables = ()
    case: Tables = ()
    untested: Tables = ()


def read_file(path: Path) -> ClaimsFile:
    """Tables of a file; InputError for one that is wrong."""
    return validate(ClaimsFile, read_toml(path), path)


@cache
def measures() -> dict[str, dict[str, str]]:
    """Description of each quantity by name, and ``source`` of the theory, by measure of cases."""
    return read_file(paths.INDEPENDENT).measure


def read_claims(path: Path = paths.CLAIMS) -> tuple[Claim, ...]:
    """Claims of a file, with shared readings in each claim and scenes as they are seen from here.

    Raises:
        InputError: anything in the file is wrong, such as a claim without a function.
    """
    file, where = read_file(path), paths.shown(path)
    entries = [*file.claim, *(row for group in file.group for row in _rows(group, "rows", where))]
    ids = Counter(str(entry.get("id")) for entry in (*entries, *file.case))
    entries += [row for case in file.case for row in _rows(case, "check", where)]
    if not entries:
        raise InputError(where, "case", "missing key")
    shared, claims = {"": None} | file.readings, list[Claim]()
    for entry in entries:
        claim = validate(Claim, entry, where, f"{entry.get('kind', CASE)} {entry.get('id')}: ")
        place = f"{claim.kind} {claim.id}"
        if ids[claim.id] > 1:
            raise InputError(where, place, "id used twice")
        for key, value, known in (
            ("shared_readings", claim.shared_readings, shared),
            ("cause", claim.cause, {"", *file.causes}),
        ):
            if value not in known:
                raise InputError(where, f"{place}: {key}", shorten(value), ", ".join(filter(None, known)) or "none")
        update: dict[str, Any] = {"file": where, "readings": shared[claim.shared_readings] or claim.readings}
        update |= {name: seen_from(path, value) for name in ("scene", "study") if (value := getattr(claim, name))}
        update["unit"] = next((unit for ending, unit in UNITS.items() if claim.quantity.endswith(ending)), claim.unit)
        claims.append(claim.model_copy(update=update))
        if claim.kind == CASE:
            _check_case(claims, where, place)
        else:
            _check_statement(claims[-1], where, place)
    return tuple(claims)


def _rows(table: dict[str, Any], key: str, where: str) -> list[dict[str, Any]]:
    """Rows of a group or a case, each with the keys of the table."""
    rows = table.get(key)
    if not rows or not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        found = f"missing key {key}" if rows is None else shorten(rows)
        raise InputError(where, f"{table.get('kind', CASE)} {table.get('id', key)}", found, "a list of tables")
    return [{name: value for name, value in table.items() if name != key} | row for row in rows]


def _check_statement(claim: Claim, where: str, place: str) -> None:
    """Raises an InputError if a statement cannot be computed or judged."""
    if claim.kind == ARITHMETIC and claim.id not in equations.paper_numbers():
        raise InputError(where, place, "no value of this id in equations.paper_numbers")
    if claim.kind != ARITHMETIC and function_of(claim) is None:
        raise InputError(where, f"{place}: measure", shorten(claim.measure), "module.function of this folder")
    if claim.expected is None:
        raise InputError(where, place, "missing key expected")
    if claim.relation == "equals" and not claim.absolute:
        raise InputError(where, place, "missing key absolute, the tolerance")
    favoured = sum(bool(reading.favoured) for reading in claim.readings)
    if favoured != 1:
        raise InputError(where, f"{place}: readings", f"{favoured} favoured readings", "one, with the reason")


def _check_case(claims: Sequence[Claim], where: str, place: str) -> None:
    """Raises an InputError if the last of some claims, a number of a case, cannot be judged."""
    claim = claims[-1]
    _exactly_one(where, place, claim, "scene", "study")
    if claim.measure not in measures():
        raise InputError(where, f"{place}: measure", shorten(claim.measure), ", ".join(measures()))
    known = [name for name in measures()[claim.measure] if name != "source"]
    if claim.quantity not in known:
        raise InputError(where, f"{place}: check.quantity", shorten(claim.quantity), ", ".join(sorted(known)))
    place += f": check {claim.quantity}"
    _exactly_one(where, place, claim, "within", "absolute")
    if claim.expected == 0 and claim.within:
        raise InputError(where, place, "within with expected = 0: no error is relative to 0; give absolute")
    if sum((claim.id, claim.quantity, claim.against) == (o.id, o.quantity, o.against) for o in claims) > 1:
        raise InputError(where, place, "check given twice", "each quantity once with expected and once without")


def _exactly_one(where: str, place: str, claim: Claim, *names: str) -> None:
    given = [name for name in names if getattr(claim, name) is not None]
    if not given:
        raise InputError(where, place, f"missing key {' or '.join(names)}")
    if len(given) > 1:
        raise InputError(where, place, f"keys {' and '.join(names)}; give one of them")


def function_of(claim: Claim, ending: str = "") -> Any:
    """Function that computes a claim, with the ending ``_theory`` its theory; None if there is no such function."""
    *module, name = claim.measure.replace(" ", "_").split(".")
    places = [equations, chains] if module else [linear_waves, strong_waves]
    for place in places:
        function = getattr(place, name + ending, None)
        if callable(function) and function.__module__ == place.__name__ and place.__name__.endswith(".".join(module)):
            return function
    return None


@cache
def cases_of(scene: str | Path | None, study: str | Path | None, settings: tuple[str, ...]) -> dict[str, Case]:
    """Cases of a number, by label: its scene, or all cases of its study, with settings.

    Raises:
        InputError: a scene, study or setting is wrong.
    """
    if scene:
        return {"": planned_case(scene, *settings)}
    file = read_study(study or "")
    for setting in settings:
        apply_setting(file.base, setting)
    return {file.label(number): plan_case(file.case(number)) for number in range(1, file.count + 1)}
