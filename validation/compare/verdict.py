"""What is said of a number: pass, fail or not run, with the tolerance and its reason."""

from dataclasses import dataclass

from drivers.base.tolerances import Tolerance

PASS, FAIL, NOT_RUN = "pass", "fail", "not run"


@dataclass(frozen=True)
class Verdict:
    """One line of the verdict table.

    Attributes:
        quantity: what was measured, such as "force against verlet".
        value, limit: the error and its tolerance; NaN where nothing was measured.
        where: time and contact of the worst value, or why nothing was measured.
    """

    scene: str
    engine: str
    quantity: str
    value: float
    limit: float
    reason: str
    where: str
    verdict: str


def judged(scene: str, engine: str, quantity: str, value: float, limit: Tolerance, where: str) -> Verdict:
    """The verdict on an error by its tolerance."""
    return Verdict(scene, engine, quantity, value, limit.limit, limit.reason, where, pass_or_fail(value, limit.limit))


def pass_or_fail(error: float, limit: float) -> str:
    """Whether an error is within its limit; what is no number fails."""
    return PASS if error <= limit else FAIL
