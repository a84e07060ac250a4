"""Checks: judged numbers, each with its limit and the reason of the limit; tables of them for a terminal.

Every verdict of the project is a ``Check``: of a run against its scheme and the exact motion, of two runs, of an
engine against a published value, of a statement of the paper.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import inf, isfinite, isnan, nan

from drivers.base.terminal import text_table
from drivers.base.tolerances import Tolerance

PASS, FAIL, NOT_RUN = "pass", "fail", "not run"
NOT_ACCURATE = "not accurate"  # of an extreme scene: an error above the general ceiling
REPRODUCED, DIFFERS = "reproduced", "differs"  # of a statement of the paper
RUN = "run"  # quantity of a check without a measurement


@dataclass(frozen=True)
class Check:
    """A judged number.

    Attributes:
        scene: scene or case.
        engine: engine, or a pair of engines.
        quantity: judged quantity, such as "model: force".
        value, limit: magnitude of the error, and the largest error allowed; NaN if nothing was measured.
        reason: reason of the limit.
        where: contact and time of the error, values compared, or the reason why nothing was measured.
        verdict: ``pass``, ``fail``, ``not run``, or another one of this module.
        found, expected: compared numbers, for a check by a published or theoretical one; else NaN.
    """

    scene: str
    engine: str
    quantity: str
    value: float
    limit: float
    reason: str
    where: str
    verdict: str
    found: float = nan
    expected: float = nan


def judged(scene: str, engine: str, quantity: str, value: float, limit: Tolerance, where: str) -> Check:
    """Check of an error by its tolerance; NaN fails."""
    return Check(scene, engine, quantity, value, limit.limit, limit.reason, where, pass_or_fail(value, limit.limit))


def without_run(scene: str, engine: str, why: str, verdict: str) -> Check:
    """Check without a measurement, with the reason."""
    return Check(scene, engine, RUN, nan, nan, "a run has to be done", why, verdict)


def pass_or_fail(error: float, limit: float) -> str:
    """Verdict on an error; NaN fails."""
    return PASS if error <= limit else FAIL


def share_of_limit(check: Check) -> float:
    """Error divided by its limit: above 1 for a failure, inf for NaN or an error where none is allowed."""
    if isnan(check.value) or (check.limit == 0 and check.value):
        return inf
    return check.value / check.limit if check.limit else 0.0


def worst_of(checks: Iterable[Check]) -> Check | None:
    """Measured check closest to its limit, or furthest beyond; None without measured numbers."""
    measured = [check for check in checks if not isnan(check.limit)]
    return max(measured, key=lambda check: (check.verdict == FAIL, share_of_limit(check)), default=None)


def outcome(checks: Iterable[Check]) -> str:
    """Verdict on several checks: fail if one fails, else not run if one is missing, else not accurate if one is."""
    verdicts = {check.verdict for check in checks}
    return next((verdict for verdict in (FAIL, NOT_RUN, NOT_ACCURATE) if verdict in verdicts), PASS)


def summary(checks: Sequence[Check]) -> str:
    """Outcome of checks in one sentence, with the names of those that failed."""
    failed = dict.fromkeys(f"{check.engine} {check.quantity}" for check in checks if check.verdict == FAIL)
    not_run = dict.fromkeys(check.engine for check in checks if check.verdict == NOT_RUN)
    skipped = f"; not run: {', '.join(not_run)}" if not_run else ""
    count = sum(check.verdict != NOT_RUN for check in checks)
    if not failed:
        return f"{PASS}: {count} of {count} checks{skipped}"
    return f"{FAIL.upper()}: {len(failed)} of {count} checks ({', '.join(failed)}){skipped}"


def table(checks: Iterable[Check]) -> list[str]:
    """Table of checks for a terminal, with a heading."""
    rows = [("scene", "engine", "quantity", "error", "allowed", "verdict, and place of the error")]
    for check in checks:
        numbers = ("", "") if check.quantity == RUN else (f"{check.value:.2e}", f"{check.limit:.2e}")
        rows.append((check.scene, check.engine, check.quantity, *numbers, f"{check.verdict}: {check.where}"))
    return text_table(rows, right=(3, 4))


def short(value: float) -> str:
    """Number with two digits and a short power of ten, such as 5.1e-11; a dash for NaN."""
    if not isfinite(value):
        return "–" if isnan(value) else "∞"
    digits, _, power = f"{value:.1e}".partition("e")
    return f"{digits}e{int(power)}" if int(power) else digits
