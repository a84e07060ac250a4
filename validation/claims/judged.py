"""Judged claims: each computed on the engines that its function takes, in the favoured reading."""

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, partial
from math import nan
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base import paths
from drivers.chain.case import Case
from drivers.engines import REFERENCE
from drivers.run.run import workers
from postproc.paper.simulate import Simulation, exact, run_codes_on
from postproc.paper.strikes import READINGS, sensor_amplitude, solve_table1
from validation.claims.chains import exact_solutions
from validation.claims.claim import Claim, Reading, function_of, parameters_of, read_claims

REPRODUCED, DIFFERS = "reproduced", "differs"


@dataclass(frozen=True)
class ComputedReading:
    """A computed reading of a claim's sentence."""

    reading: Reading
    value: float
    verdict: str


@dataclass(frozen=True)
class Judged:
    """A claim with the values computed for it.

    Attributes:
        computed: values by engine for the favoured reading; by ``reference`` only if no chain is simulated.
        how: description of the computed quantity.
        readings: all readings, by the reference; empty if there is one only.
    """

    claim: Claim
    computed: Mapping[str, float]
    how: str
    readings: tuple[ComputedReading, ...] = ()

    @property
    def value(self) -> float:
        """Value of the reference."""
        return self.computed.get(REFERENCE, nan)

    @property
    def verdict(self) -> str:
        """Verdict on the value of the reference."""
        return verdict_of(self.claim, self.value)

    @property
    def hangs(self) -> bool:
        """True if another reading of the sentence gives another verdict."""
        return len({each.verdict for each in self.readings}) > 1

    @property
    def fault(self) -> str:
        """Fault of a claim: a difference without an explanation, the reverse, or engines that disagree; else empty."""
        if self.verdict == DIFFERS and not self.claim.explained:
            return f"differs without an explanation: {self.value:.6g}, quoted {self.claim.quoted:g}"
        if self.verdict == REPRODUCED and self.claim.explained:
            return "is reproduced, but a difference is explained"
        other = [e for e, v in self.computed.items() if verdict_of(self.claim, v) != self.verdict]
        return f"{', '.join(other)} disagree with the reference" if other else ""


def verdict_of(claim: Claim, value: float) -> str:
    """Verdict on a value."""
    return REPRODUCED if claim.holds_for(value) else DIFFERS


def judge_all(runs: Path = paths.RUNS) -> list[Judged]:
    """Computes and judges every claim; claims on simulated chains on every engine.

    Table 1 is solved while the reference computes the simulated claims. The codes then run the same cases, while the
    reference computes the other readings.

    Raises:
        RunError: a run failed.
    """
    claims = read_claims().claim
    asked: dict[str, Case] = {}

    @cache
    def solved(setting: str, force_is: str) -> pd.DataFrame:
        if READINGS[force_is] is not sensor_amplitude:
            return exact_solutions(setting, force_is)
        return solve_table1(runs, setting)

    def takes(claim: Claim) -> set[str]:
        return parameters_of(function_of(claim)) & {"run", "table"}

    def noted(case: Case) -> Simulation:
        asked[_key(case)] = case
        return exact(case)

    def values_with(name: str, given: Any) -> dict[str, Any]:
        """Values of claims whose functions take ``run``, or ``table``."""
        taking = (claim for claim in claims if name in takes(claim))
        return {claim.id: _call(claim, claim.favoured, **{name: given}) for claim in taking}

    def others() -> tuple[dict[str, Any], dict[str, tuple[ComputedReading, ...]]]:
        """Values of claims that take neither, and all readings of all claims by the reference."""
        rest = {claim.id: {REFERENCE: _call(claim, claim.favoured)} for claim in claims if not takes(claim)}
        exact_values = {name: each[REFERENCE] for name, each in (computed | rest).items()} | found[REFERENCE]
        return rest, {claim.id: _readings(claim, exact_values[claim.id]) for claim in claims}

    with workers(1) as pool:
        tables = pool.submit(values_with, "table", solved)
        found = {REFERENCE: values_with("run", noted)}
        computed = tables.result()
        reading = pool.submit(others)
        for code, simulations in run_codes_on([*asked.values()], runs).items():
            found[code] = values_with("run", partial(_done, dict(zip(asked, simulations, strict=True))))
        rest, readings = reading.result()
    simulated = {name: {engine: float(own[name]) for engine, own in found.items()} for name in found[REFERENCE]}
    values = computed | rest | simulated
    return [Judged(claim, values[claim.id], _how(claim), readings[claim.id]) for claim in claims]


def _done(done: Mapping[str, Simulation], case: Case) -> Simulation:
    """Finished simulation of a case."""
    return done[_key(case)]


def _key(case: Case) -> str:
    """The scene of a case, as text."""
    return case.scene.model_dump_json()


def _call(claim: Claim, reading: Reading, **given: Any) -> Any:
    """Result of the claim's function for one reading, with ``run`` or ``table`` if it takes them."""
    function = function_of(claim)
    assert function is not None
    taken = {name: each for name, each in given.items() if name in parameters_of(function)}
    return function(**taken, **(claim.arguments | reading.arguments))


def _readings(claim: Claim, favoured: float) -> tuple[ComputedReading, ...]:
    """All readings by the reference; the value of the favoured one is known."""
    found = []
    for reading in claim.readings:
        value = favoured if reading.favoured else _call(claim, reading, run=exact, table=exact_solutions)
        value = value[REFERENCE] if isinstance(value, dict) else float(value)
        found.append(ComputedReading(reading, value, verdict_of(claim, value)))
    return tuple(found)


def _how(claim: Claim) -> str:
    text = claim.how or inspect.getdoc(function_of(claim)) or ""
    return " ".join(text.partition("\n\n")[0].replace("``", "").split())
