"""Verdicts: pass, fail or not run, with the tolerance and its reason."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import inf, isfinite, isnan, nan

from drivers.base.tolerances import Tolerance
from drivers.engines import engine_names

PASS, FAIL, NOT_RUN = "pass", "fail", "not run"
RUN = "run"  # quantity of a verdict without a measurement


@dataclass(frozen=True)
class Verdict:
    """One row of the verdict table.

    Attributes:
        quantity: measured quantity, such as "force against verlet".
        value, limit: error and tolerance; NaN if nothing was measured.
        where: time and contact of the largest error, or the reason why nothing was measured.
        predicted: expected error of a faultless run, a part of the limit.
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
    """Verdict on an error by its tolerance."""
    verdict = pass_or_fail(value, limit.limit)
    return Verdict(scene, engine, quantity, value, limit.limit, limit.reason, where, verdict, limit.predicted)


def without_run(scene: str, engine: str, why: str, verdict: str) -> Verdict:
    """Verdict without a measurement, with the reason."""
    return Verdict(scene, engine, RUN, nan, nan, "a run has to be done", why, verdict)


def share_of_tolerance(verdict: Verdict) -> float:
    """Excess of an error over its prediction, over the allowed excess; 0 if the error is below the prediction."""
    beyond, allowed = max(verdict.value - verdict.predicted, 0.0), verdict.limit - verdict.predicted
    if isnan(verdict.value) or (allowed == 0 and beyond):
        return inf
    return beyond / allowed if allowed else 0.0


@dataclass(frozen=True)
class Columns:
    """Widths of the first columns of tables in the terminal."""

    scene: int = 12
    engine: int = 10
    quantity: int = 24

    @classmethod
    def fitting(cls, rows: Iterable[tuple[str, str, str]]) -> "Columns":
        """Columns that hold scenes, engines and quantities, and the names of all engines."""
        scenes, engines, quantities = zip(*rows, ("", "", ""), strict=True)
        engines = (*engines, *engine_names())
        least = cls()
        return cls(
            max(least.scene, *map(len, scenes)),
            max(least.engine, *map(len, engines)),
            max(least.quantity, *map(len, quantities)),
        )

    def names(self, scene: str, engine: str) -> str:
        """First two columns."""
        return f"{scene:<{self.scene}} {engine:<{self.engine}}"

    def heading(self) -> str:
        """Heading of the verdict table."""
        return f"{self.names('scene', 'engine')} {'quantity':<{self.quantity}} {'error':>9} {'allowed':>9}  verdict"

    def line_of(self, verdict: Verdict) -> str:
        """Row of the verdict table."""
        numbers = f"{verdict.value:9.2e} {verdict.limit:9.2e}" if verdict.quantity != RUN else " " * 19
        labels = f"{self.names(verdict.scene, verdict.engine)} {verdict.quantity:<{self.quantity}}"
        return f"{labels} {numbers}  {verdict.verdict}: {verdict.where}"


def table(verdicts: Sequence[Verdict]) -> list[str]:
    """Verdict table in the terminal."""
    columns = Columns.fitting((each.scene, each.engine, each.quantity) for each in verdicts)
    return [columns.heading(), *map(columns.line_of, verdicts)]


def summary(verdicts: Sequence[Verdict]) -> str:
    """Summary of verdicts in one sentence, naming what failed."""
    failed = dict.fromkeys(f"{each.engine} {each.quantity}" for each in verdicts if each.verdict == FAIL)
    not_run = dict.fromkeys(each.engine for each in verdicts if each.verdict == NOT_RUN)
    skipped = f"; not run: {', '.join(not_run)}" if not_run else ""
    checks = sum(each.verdict != NOT_RUN for each in verdicts)
    if not failed:
        return f"{PASS}: {checks} of {checks} checks{skipped}"
    return f"{FAIL.upper()}: {len(failed)} of {checks} checks ({', '.join(failed)}){skipped}"


def outcome(verdicts: Sequence[Verdict]) -> str:
    """Verdict on an engine: fail if one of its verdicts fails, else not run if one is missing."""
    found = {verdict.verdict for verdict in verdicts}
    return FAIL if FAIL in found else NOT_RUN if NOT_RUN in found else PASS


def short(value: float) -> str:
    """Number with two digits and a short power of ten, such as 5.1e-11; a dash for NaN."""
    if not isfinite(value):
        return "–" if isnan(value) else "∞"
    digits, _, power = f"{value:.1e}".partition("e")
    return f"{digits}e{int(power)}" if int(power) else digits


def pass_or_fail(error: float, limit: float) -> str:
    """Verdict on an error; NaN fails."""
    return PASS if error <= limit else FAIL
