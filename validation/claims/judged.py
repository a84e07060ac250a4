"""Judged claims: each computed on the engines that its function takes, in the favoured reading."""

import inspect
from collections.abc import Iterable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base import paths
from drivers.chain.case import Case
from drivers.engines import REFERENCE
from drivers.run.execute import side_by_side
from postproc.paper.simulate import Simulation, exact, run_codes_on
from postproc.paper.strikes import READINGS, exact_table1, sensor_amplitude, solve_table1
from validation.checks import Check
from validation.claims.claim import Claim, Reading, function_of, given_to, read_claims

REPRODUCED, DIFFERS = "reproduced", "differs"


def check_of(claim: Claim, reading: Reading, engine: str, value: float) -> Check:
    """Verdict on a value; the scene is the id of the claim, and a difference has its explanation in ``where``."""
    error = claim.error(value)
    verdict = REPRODUCED if error <= claim.limit else DIFFERS
    where = f"{claim.where}: computed {value:.6g}, quoted {claim.quoted:g} {claim.unit}".rstrip()
    where += f": {claim.explained}" if verdict == DIFFERS and claim.explained else ""
    quantity, limit = quantity_of(claim, reading), claim.limit
    return Check(claim.id, engine, quantity, error, limit, claim.because, where, verdict, value, claim.quoted)


def quantity_of(claim: Claim, reading: Reading) -> str:
    """Function of a claim, with the reading of the sentence if there are several."""
    return f"{claim.compute} ({reading.words})" if reading.words else claim.compute


def favoured(claim: Claim, checks: Iterable[Check]) -> dict[str, Check]:
    """Checks of the favoured reading by engine; by ``reference`` only if no chain is simulated."""
    return {check.engine: check for check in checks if check.quantity == quantity_of(claim, claim.favoured)}


def hangs(checks: Iterable[Check]) -> bool:
    """True if another reading of the sentence gives another verdict."""
    return len({check.verdict for check in checks if check.engine == REFERENCE}) > 1


def fault_of(claim: Claim, checks: Sequence[Check]) -> str:
    """Fault of a claim: a difference without an explanation, the reverse, or engines that disagree; else empty."""
    judged = favoured(claim, checks)
    check = judged[REFERENCE]
    if check.verdict == DIFFERS and not claim.explained:
        return f"differs without an explanation: {check.found:.6g}, quoted {claim.quoted:g}"
    if check.verdict == REPRODUCED and claim.explained:
        return "is reproduced, but a difference is explained"
    other = [engine for engine, each in judged.items() if each.verdict != check.verdict]
    return f"{', '.join(other)} disagree with the reference" if other else ""


def judge_all(runs: Path = paths.RUNS) -> list[Check]:
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
            return exact_table1(setting, force_is)
        return solve_table1(runs, setting)

    def noted(case: Case) -> Simulation:
        asked[_key(case)] = case
        return exact(case)

    def values_with(**given: Any) -> dict[str, Any]:
        """Values of claims whose functions take just these of ``run`` and ``table``."""
        return {claim.id: _call(claim, claim.favoured, **given) for claim in claims if given_to(claim) == set(given)}

    def on_codes() -> dict[str, dict[str, Any]]:
        """Values by code of the claims on simulated chains."""
        values = {}
        for code, simulations in run_codes_on([*asked.values()], runs).items():
            done = dict(zip(asked, simulations, strict=True))
            values[code] = values_with(run=lambda case, done=done: done[_key(case)])
        return values

    def others() -> tuple[dict[str, Any], list[Check]]:
        """Values of claims that take neither, and the other readings of all claims by the reference."""
        return values_with(), [check for claim in claims for check in _other_readings(claim)]

    first: dict[str, Any] = {"table": partial(values_with, table=solved), "run": partial(values_with, run=noted)}
    second: dict[str, Any] = {"codes": on_codes, "others": others}
    done = dict(side_by_side(first)) | dict(side_by_side(second))
    found, (rest, readings) = {REFERENCE: done["run"]} | done["codes"], done["others"]
    values = done["table"] | {name: {REFERENCE: value} for name, value in rest.items()}
    values |= {name: {engine: float(own[name]) for engine, own in found.items()} for name in found[REFERENCE]}
    checks = []
    for claim in claims:
        checks += [check_of(claim, claim.favoured, engine, value) for engine, value in values[claim.id].items()]
        checks += [check for check in readings if check.scene == claim.id]
    return checks


def _key(case: Case) -> str:
    """The scene of a case, as text."""
    return case.scene.model_dump_json()


def _call(claim: Claim, reading: Reading, **given: Any) -> Any:
    """Result of the claim's function for one reading, with ``run`` or ``table`` if it takes them."""
    function = function_of(claim)
    assert function is not None
    taken = {name: each for name, each in given.items() if name in given_to(claim)}
    return function(**taken, **(claim.arguments | reading.arguments))


def _other_readings(claim: Claim) -> Iterator[Check]:
    """Readings that the text does not favour, by the reference."""
    for reading in claim.readings:
        if not reading.favoured:
            value = _call(claim, reading, run=exact, table=exact_table1)
            value = value[REFERENCE] if isinstance(value, dict) else float(value)
            yield check_of(claim, reading, REFERENCE, value)


def how_computed(claim: Claim) -> str:
    """Description of the computed quantity: the claim's, or the first sentence of its function."""
    text = claim.how or inspect.getdoc(function_of(claim)) or ""
    return " ".join(text.partition("\n\n")[0].replace("``", "").split())
