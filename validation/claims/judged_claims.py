"""Judges every claim of ``inputs/paper/claims.toml`` and writes ``results/claims.csv``."""

import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import whole_file
from drivers.base.messages import validate
from drivers.chain.case import Case
from drivers.engines import installed_codes, missing_codes
from drivers.run.many import workers
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml
from postproc.paper.simulate import Simulation, exact, run_codes
from postproc.read.residual import REFERENCE
from validation.claims import (
    conservation,
    equations,
    exact_waves,
    moduli,
    sensor_beads,
    solitary_waves,
    striker_pulse,
    trains,
)
from validation.claims import material_claims as materials
from validation.claims import table1_claims as table1
from validation.claims.simulated import Run

REPRODUCED, DIFFERS, EXPERIMENT_ONLY = "reproduced", "differs", "experiment only"
PLAIN: dict[str, Callable[[], float]] = {
    **equations.COMPUTED,
    **exact_waves.COMPUTED,
    **materials.COMPUTED,
    **conservation.COMPUTED,
    **moduli.COMPUTED,
}
SIMULATED: dict[str, Callable[[Run], float]] = {
    **solitary_waves.COMPUTED,
    **sensor_beads.COMPUTED,
    **trains.COMPUTED,
    **striker_pulse.COMPUTED,
}


class Claim(Part):
    """A statement of the paper; see the head of the file for the keys."""

    id: str
    where: str
    quote: str
    quoted: Annotated[float, Field(allow_inf_nan=False)]
    unit: str = ""
    relation: Literal["equals", "at most", "at least"] = "equals"
    within: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    because: str = ""
    explained: str = ""
    experiment: bool = False
    ours: bool = False
    arithmetic: bool = False
    note: str = ""

    def holds_for(self, value: float) -> bool:
        """Whether a computed value agrees with the statement; NaN does not."""
        if self.relation == "at most":
            return value <= self.quoted
        if self.relation == "at least":
            return value >= self.quoted
        return abs(value - self.quoted) <= (self.within or 0.0)


class ClaimsFile(Part):
    """The file."""

    claim: Annotated[tuple[Claim, ...], Field(strict=False)]


@dataclass(frozen=True)
class Judged:
    """A claim with what came out.

    Attributes:
        computed: by engine; what no engine enters stands under ``reference``. Empty where nothing is computed.
        how: what was computed.
    """

    claim: Claim
    computed: dict[str, float]
    how: str

    @property
    def value(self) -> float:
        """The reference's value."""
        return self.computed.get(REFERENCE, float("nan"))

    @property
    def verdict(self) -> str:
        """By the reference's value."""
        if self.claim.experiment:
            return EXPERIMENT_ONLY
        return REPRODUCED if self.claim.holds_for(self.value) else DIFFERS

    @property
    def off(self) -> float:
        """Computed less quoted."""
        return self.value - self.claim.quoted

    @property
    def fault(self) -> str:
        """Why this cannot stand: a difference that nobody explained or an explanation without one, engines apart."""
        if self.verdict == DIFFERS and not self.claim.explained:
            return f"differs without an explanation: {self.value:.6g}, quoted {self.claim.quoted:g}"
        if self.verdict == REPRODUCED and self.claim.explained:
            return "is reproduced, but a difference is explained"
        other = [e for e, v in self.computed.items() if self.claim.holds_for(v) != self.claim.holds_for(self.value)]
        return f"{', '.join(other)} disagree with the reference" if other and not self.claim.experiment else ""


def read_claims(path: Path = paths.CLAIMS) -> tuple[Claim, ...]:
    """The claims of the file.

    Raises:
        InputError: anything wrong with it, a claim that nothing computes included.
    """
    where = paths.shown(path)
    claims = validate(ClaimsFile, read_toml(path), where).claim
    counts = Counter(claim.id for claim in claims)
    computable = {*PLAIN, *SIMULATED, *table1.all_ids()}
    for claim in claims:
        key = f"claim {claim.id}"
        if counts[claim.id] > 1:
            raise InputError(where, key, "the same id twice", "an id of its own for each claim")
        if claim.experiment:
            continue
        if claim.id not in computable:
            raise InputError(where, key, "nothing that computes it", "an id of a function in validation/claims")
        if claim.relation == "equals" and claim.within is None:
            raise InputError(where, key, "no within", "a tolerance")
        if not claim.because:
            raise InputError(where, key, "no because", "the reason of the tolerance")
    forgotten = sorted(computable - set(counts))
    if forgotten:
        raise InputError(where, "claim", f"no {forgotten[0]}", "a claim for everything that is computed")
    return claims


def judge_all(runs: Path = paths.RUNS) -> list[Judged]:
    """Computes and judges every claim; what simulations enter is computed by every engine.

    Raises:
        RunError: a run failed.
    """
    claims = read_claims()
    printed, how = table1.compute(runs), table1.all_ids()
    simulated = _by_engine(runs)
    judged = []
    for claim in claims:
        if claim.id in printed:
            judged.append(Judged(claim, printed[claim.id], how[claim.id]))
        elif claim.id in PLAIN:
            judged.append(Judged(claim, {REFERENCE: PLAIN[claim.id]()}, _words(PLAIN[claim.id])))
        elif claim.id in SIMULATED:
            computed = {engine: values[claim.id] for engine, values in simulated.items()}
            judged.append(Judged(claim, computed, _words(SIMULATED[claim.id])))
        else:
            judged.append(Judged(claim, {}, ""))
    return judged


def _by_engine(runs: Path) -> dict[str, dict[str, float]]:
    """All claims on simulated chains by every engine, the codes side by side."""
    engines: dict[str, Run] = {REFERENCE: exact} | {code: _runner(code, runs) for code in installed_codes()}

    def compute(run: Run) -> dict[str, float]:
        return {name: function(run) for name, function in SIMULATED.items()}

    with workers(len(engines)) as pool:
        return dict(zip(engines, pool.map(compute, engines.values()), strict=True))


def _runner(code: str, runs: Path) -> Run:
    def run(case: Case) -> Simulation:
        return run_codes({code: [case]}, runs)[code][0]

    return run


def _words(function: Callable[..., Any]) -> str:
    return " ".join((function.__doc__ or "").replace("``", "").split())


def counted(judged: list[Judged]) -> str:
    """How many claims have which verdict, in words."""
    counts = Counter(each.verdict for each in judged)
    plain = sum(each.claim.arithmetic for each in judged if each.verdict == REPRODUCED)
    reproduced = f"{counts[REPRODUCED]} reproduced ({plain} of them by plain arithmetic)"
    return f"{reproduced}, {counts[DIFFERS]} differ, {counts[EXPERIMENT_ONLY]} of the experiment only"


def claims_table(judged: list[Judged]) -> pd.DataFrame:
    """A row per claim."""
    engines = list(dict.fromkeys(engine for each in judged for engine in each.computed))
    rows = []
    for each in judged:
        claim = each.claim
        rows.append({
            "id": claim.id, "where": claim.where, "quote": claim.quote, "relation": claim.relation,
            "quoted": claim.quoted, "number_is": "ours" if claim.ours else "the paper's", "unit": claim.unit,
            "kind": "arithmetic" if claim.arithmetic else "computed",
            "within": claim.within, "because": claim.because,
            **{engine: each.computed.get(engine, np.nan) for engine in engines},
            "difference": each.off, "verdict": each.verdict, "why": claim.explained or claim.note, "how": each.how,
        })  # fmt: skip
    return pd.DataFrame(rows)


def write_claims(judged: list[Judged], path: Path) -> None:
    """Writes the table, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as draft:
        claims_table(judged).to_csv(draft, index=False)


def claims(out: Path, runs: Path) -> int:
    """Judges every claim, writes the table and says what differs; the exit code is 1 where a claim is at fault."""
    judged = judge_all(runs)
    write_claims(judged, out)
    for each in judged:
        if each.verdict == DIFFERS:
            claim = each.claim
            print(f"{claim.id}: quoted {claim.quoted:g}, computed {each.value:.4g} {claim.unit}: {claim.explained}")
    print(f"{paths.shown(out)}: {counted(judged)}")
    if missing_codes():
        print(f"without what is not installed: {', '.join(missing_codes())}", file=sys.stderr)
    faults = [each for each in judged if each.fault]
    for each in faults:
        print(f"{each.claim.id}: {each.fault}", file=sys.stderr)
    return 1 if faults else 0
