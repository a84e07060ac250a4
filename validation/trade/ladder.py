"""What is run: each scene at steps from the predicted stability limit down to 1e-4 of it, within a budget of time."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, inf

from drivers.chain.case import Case
from drivers.engines import codes, installed_codes
from drivers.limits.stable_step import predicted_limit
from postproc.paper.simulate import case_of
from postproc.read.residual import REFERENCE
from validation.accuracy.costs import cost_on
from validation.reference.adaptive import LEAST_TOLERANCE

SCENES = ("fig4", "fig5", "fig6b", "fig6d", "low-amplitude", "steel-chain", "long-chain")
SHARES = tuple(10 ** (-k / 3) for k in range(13))  # of the predicted stability limit
TOLERANCES = (*(10.0**-k for k in range(2, 12)), LEAST_TOLERANCE)
ORDER_4, ADAPTIVE, VERLET = "order 4", "adaptive", "verlet"
STEP_FORCES = {ORDER_4: 4}  # forces a step, where it is more than one
BUDGET_S = 300.0  # of engine time for the whole ladder
LONGEST = 0.04  # of the budget: no single run takes more


@dataclass(frozen=True)
class Rung:
    """One run of the ladder.

    Attributes:
        method: an engine, or an integrator of this repository.
        case: at its time step and samples.
        share: of the predicted stability limit; of ``ADAPTIVE`` the tolerance.
        expected_s: of its loop.
    """

    scene: str
    method: str
    case: Case
    share: float
    expected_s: float


def rungs_of(scene: str) -> Iterator[Rung]:
    """Every code and in-repo method at every step, and the adaptive integrator at every tolerance."""
    base = case_of(scene)
    stable_s = predicted_limit(base.chain, float(base.sample_times_s[-1]))
    for share in SHARES:
        case = at_step(base, share, stable_s)
        for method in (*installed_codes(), VERLET, ORDER_4):
            yield Rung(scene, method, case, share, expected_loop_s(method, case))
    for tolerance in TOLERANCES:
        yield Rung(scene, ADAPTIVE, base, tolerance, cost_on(REFERENCE).loop_s(base))


def expected_loop_s(method: str, case: Case) -> float:
    """Expected seconds of a fixed-step loop; a code that nobody has measured is taken for the slowest one."""
    if method in STEP_FORCES:
        return STEP_FORCES[method] * expected_loop_s(VERLET, case)
    known = cost_on(method).loop_s(case)
    return (
        known if known < inf else max(cost for name in (VERLET, *codes()) if (cost := cost_on(name).loop_s(case)) < inf)
    )


def at_step(case: Case, share: float, stable_s: float) -> Case:
    """The case at about a share of the stability limit; where that exceeds the sample interval, with fewer samples."""
    step = share * stable_s
    interval = case.scene.run.sample_interval
    if step <= interval:
        return case.at(ceil(interval / step * (1 - 1e-12)))
    return case.sampled_at_every(step)


def affordable(rungs: list[Rung], budget_s: float) -> tuple[list[Rung], list[Rung]]:
    """Rungs that fit the budget, cheapest first, and those that do not."""
    kept: list[Rung] = []
    left: list[Rung] = []
    spent = 0.0
    for rung in sorted(rungs, key=lambda rung: rung.expected_s):
        fits = rung.expected_s <= LONGEST * budget_s and spent + rung.expected_s <= budget_s
        (kept if fits else left).append(rung)
        spent += rung.expected_s if fits else 0.0
    return kept, left
