"""What is said of a number: pass, fail or not run, with the tolerance and its reason."""

from dataclasses import dataclass
from functools import cache
from math import inf, isnan, nan

from drivers.base.tolerances import Tolerance
from drivers.engines import engine_names

PASS, FAIL, NOT_RUN = "pass", "fail", "not run"
RUN = "run"  # the quantity where there is nothing to measure


@dataclass(frozen=True)
class Verdict:
    """One line of the verdict table.

    Attributes:
        quantity: what was measured, such as "force against verlet".
        value, limit: the error and its tolerance; NaN where nothing was measured.
        where: time and contact of the worst value, or why nothing was measured.
        predicted: the part of the limit that a run without faults is expected to take.
    """

    scene: str
    engine: str
    quantity: str
    value: float
    limit: float
    reason: str
    where: str
    verdict: str
    predicted: float = 0.0


def judged(scene: str, engine: str, quantity: str, value: float, limit: Tolerance, where: str) -> Verdict:
    """The verdict on an error by its tolerance."""
    verdict = pass_or_fail(value, limit.limit)
    return Verdict(scene, engine, quantity, value, limit.limit, limit.reason, where, verdict, limit.predicted)


def without_run(scene: str, engine: str, why: str, verdict: str) -> Verdict:
    """The verdict where there is nothing to measure, and why."""
    return Verdict(scene, engine, RUN, nan, nan, "a run has to be done", why, verdict)


def share_of(verdict: Verdict) -> float:
    """A figure beyond what was predicted, over what is allowed beyond it; 0 where it is less."""
    beyond, allowed = max(verdict.value - verdict.predicted, 0.0), verdict.limit - verdict.predicted
    if isnan(verdict.value) or (allowed == 0 and beyond):
        return inf
    return beyond / allowed if allowed else 0.0


def names(scene: str, engine: str) -> str:
    """The first two columns of tables for a terminal."""
    return f"{scene:<12} {engine:<{_width()}}"


@cache
def _width() -> int:
    return max(10, *map(len, engine_names()))


def heading() -> str:
    """The heading of the verdict table for a terminal."""
    return f"{names('scene', 'engine')} {'quantity':<24} {'error':>9} {'allowed':>9}  verdict"


def line_of(verdict: Verdict) -> str:
    """A line of the verdict table for a terminal."""
    numbers = f"{verdict.value:9.2e} {verdict.limit:9.2e}" if verdict.quantity != RUN else " " * 19
    beside = f"{names(verdict.scene, verdict.engine)} {verdict.quantity:<24}"
    return f"{beside} {numbers}  {verdict.verdict}: {verdict.where}"


def pass_or_fail(error: float, limit: float) -> str:
    """Whether an error is within its limit; what is no number fails."""
    return PASS if error <= limit else FAIL
