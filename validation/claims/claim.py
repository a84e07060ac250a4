"""The paper's statements as data: claims, readings of their sentences, and untested statements."""

import inspect
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import shorten, validate
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml
from postproc.paper.quoted import quoted
from validation.claims import dissipation, equations, single_waves, trains
from validation.claims.paper_numbers import paper_numbers

MODULES = {"equations": equations, "single_waves": single_waves, "trains": trains, "dissipation": dissipation}
PHYSICS, FITTED, CERTAIN, ARITHMETIC = "physics", "fitted", "certain", "arithmetic"  # kinds, in the order of the report

Arguments = dict[str, float | str]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class Reading(Part):
    """One way to read a sentence.

    Attributes:
        words: the reading, in a few words.
        arguments: arguments of the claim's function, in addition to those of the claim.
        favoured: reason why this reading is judged; empty for the others.
    """

    words: str
    arguments: Arguments = Field(default_factory=dict)
    favoured: str = ""


Readings = Annotated[tuple[Reading, ...], Field(strict=False, min_length=2)]  # of one sentence


PLAIN_READING = Reading(words="")  # of a sentence with one meaning


class Claim(Part):
    """A statement of the paper; see the head of the file for the keys."""

    id: str
    where: str
    quote: str
    kind: Literal["physics", "fitted", "certain", "arithmetic"]
    compute: str = ""
    arguments: Arguments = Field(default_factory=dict)
    how: str = ""
    quoted: Finite
    unit: str = ""
    relation: Literal["equals", "at most", "at least"] = "equals"
    within: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    because: str = ""
    explained: str = ""
    cause: str = ""
    ours: bool = False
    readings: Readings = ()
    shared_readings: str = ""

    @property
    def favoured(self) -> Reading:
        """The judged reading."""
        return next((reading for reading in self.readings if reading.favoured), PLAIN_READING)

    @property
    def limit(self) -> float:
        """Allowed error."""
        return (self.within or 0.0) if self.relation == "equals" else 0.0

    def error(self, value: float) -> float:
        """Deviation of a computed value from the statement; NaN for NaN."""
        off = value - self.quoted
        if self.relation == "equals":
            return abs(off)
        return max(off if self.relation == "at most" else -off, 0.0)  # of NaN and 0 the first: NaN


class Untested(Part):
    """An untested statement, with the reason."""

    where: str
    quote: str
    reason: str


class ClaimsFile(Part):
    """The file ``inputs/paper/claims.toml``: shared readings, causes of differences, claims, untested statements."""

    readings: dict[str, Readings] = Field(default_factory=dict)
    causes: dict[str, str] = Field(default_factory=dict)
    claim: Annotated[tuple[Claim, ...], Field(strict=False, min_length=1)]
    untested: Annotated[tuple[Untested, ...], Field(strict=False)] = ()


def read_claims(path: Path = paths.CLAIMS) -> ClaimsFile:
    """Reads the file; rows of a ``[[group]]`` are claims with the group's keys, and shared readings go into each claim.

    Raises:
        InputError: anything in the file is wrong, such as a claim without a function.
    """
    where, given = paths.shown(path), read_toml(path)
    for group in given.pop("group", []):
        given["claim"] = [*given.get("claim", []), *(group | row for row in group.pop("rows", []))]
    file = validate(ClaimsFile, given, where)
    counts = Counter(claim.id for claim in file.claim)
    for claim in file.claim:
        if counts[claim.id] > 1:
            raise InputError(where, f"claim {claim.id}", "id used twice")
        for key, value, known in (
            ("shared_readings", claim.shared_readings, file.readings),
            ("cause", claim.cause, file.causes),
        ):
            if value not in {"", *known}:
                raise InputError(where, f"claim {claim.id}: {key}", f'"{shorten(value)}"', ", ".join(known) or "none")
    claims = tuple(
        claim.model_copy(update={"readings": file.readings.get(claim.shared_readings, claim.readings)})
        for claim in file.claim
    )
    for claim in claims:
        _check(claim, where)
    return file.model_copy(update={"claim": claims})


def _check(claim: Claim, where: str) -> None:
    """Raises an InputError if a claim cannot be computed or judged."""
    key = f"claim {claim.id}"
    if claim.kind == ARITHMETIC:
        if claim.id not in paper_numbers():
            raise InputError(where, key, "no value of this id in validation/claims/paper_numbers.py")
    elif function_of(claim) is None:
        raise InputError(where, f"{key}: compute", shorten(claim.compute), f"module.function of {', '.join(MODULES)}")
    else:
        for reading in claim.readings or (PLAIN_READING,):
            _check_arguments(claim, claim.arguments | reading.arguments, where)
    if claim.relation == "equals" and claim.within is None:
        raise InputError(where, key, "missing key within, the tolerance")
    if not claim.because:
        raise InputError(where, key, "missing key because, the reason of the tolerance")
    favoured = sum(bool(reading.favoured) for reading in claim.readings)
    if claim.readings and favoured != 1:
        raise InputError(where, f"{key}: readings", f"{favoured} favoured readings", "one, with the reason")


def _check_arguments(claim: Claim, arguments: Arguments, where: str) -> None:
    function, key = function_of(claim), f"claim {claim.id}"
    amplitude, amplitudes = arguments.get("force_N"), quoted().table1.force_N
    if amplitude is not None and amplitude not in amplitudes:
        allowed = ", ".join(f"{force_N:g}" for force_N in amplitudes)
        raise InputError(where, f"{key}: arguments.force_N", str(amplitude), allowed)
    try:
        if function:
            inspect.signature(function).bind(*given_to(claim), **arguments)
    except TypeError as error:
        raise InputError(where, f"{key}: arguments", str(error), f"the arguments of {claim.compute}") from error


def function_of(claim: Claim) -> Callable[..., Any] | None:
    """Function that computes a claim; None if no function has this name."""
    module, _, name = claim.compute.partition(".")
    function = getattr(MODULES.get(module), name, None)
    public = inspect.isfunction(function) and function.__module__.endswith(f".{module}") and not name.startswith("_")
    return function if public else None


def given_to(claim: Claim) -> set[str]:
    """Arguments that the study passes to a claim's function: ``run``, ``table`` or none."""
    function = function_of(claim)
    return set(inspect.signature(function).parameters) & {"run", "table"} if function else set()
