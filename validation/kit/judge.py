"""Verdicts on an engine: all checks in order, one row each, and the table."""

import time
import tomllib
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from math import isnan, nan
from pathlib import Path
from tempfile import TemporaryDirectory

from drivers.base import paths
from drivers.base.errors import InputError, RunError, one_line
from drivers.engines import Engine, load_engine
from drivers.run.build import build_of
from drivers.run.session import Session
from validation.accuracy.costs import Cost, keep
from validation.compare.verdict import FAIL, NOT_RUN, PASS
from validation.kit import adapter_checks, output_checks, physics_checks
from validation.kit.candidate import Candidate, Measured, NotRunError, kit_file
from validation.studies import write_table

Check = Callable[[Candidate], Iterable[Measured]]
SERVER = "server"
CHECKS: dict[str, Check] = {
    "interface": adapter_checks.interface,
    "version and identity": adapter_checks.version,
    "deck": adapter_checks.deck_of_physics,
    "deck by hand": adapter_checks.deck_by_hand,
    SERVER: output_checks.server,
    "damaged output": output_checks.damaged_output,
    "failures and time limit": output_checks.failures,
    "cost": output_checks.cost,
    "start": output_checks.start,
    **{f"scene: {each.name}": partial(physics_checks.scene, variant=each) for each in kit_file().variant},
    "order": physics_checks.order,
    "restitution": physics_checks.restitution,
    "blow-up": physics_checks.blow_up,
    "sabotage": physics_checks.sabotage,
}


@dataclass(frozen=True)
class Row:
    """Row of the table, for one check; values are NaN if nothing was measured.

    Attributes:
        words: description of the measured value, or the reason of a failure or of a check that was not run.
    """

    engine: str
    check: str
    verdict: str
    value: float
    limit: float
    words: str
    seconds: float


def judge(engine: Engine, home: Path, names: Iterable[str] = tuple(CHECKS)) -> Iterator[Row]:
    """Run the named checks.

    A check that raises gives a failed row; the others still run. Checks of physics use the engine's server unless its
    check failed.

    Raises:
        RunError: the engine is not installed.
    """
    build = build_of(engine, home)
    with TemporaryDirectory() as folder, closing(Session(engine, build.command, Path(folder, "session"))) as session:
        candidate = Candidate(engine, build, Path(folder), session)
        for name in names:
            row = _row(candidate, name)
            if name == SERVER and row.verdict == FAIL:
                candidate = replace(candidate, session=None)
            yield row


def _row(candidate: Candidate, name: str) -> Row:
    began = time.perf_counter()

    def row(verdict: str, value: float, limit: float, words: str) -> Row:
        return Row(candidate.engine.name, name, verdict, value, limit, words, round(time.perf_counter() - began, 3))

    try:
        worst = max(CHECKS[name](candidate), key=lambda each: each.share)
    except NotRunError as reason:
        return row(NOT_RUN, nan, nan, str(reason))
    except Exception as error:  # adapters may raise anything
        kind = "" if isinstance(error, RunError | InputError) else f"{type(error).__name__}: "
        return row(FAIL, nan, nan, one_line(kind, error))
    return row(PASS if worst.share <= 1 else FAIL, worst.value, worst.limit, worst.words)


def judge_engine(name: str, runs: Path, results: Path | None) -> int:
    """Print the table of an engine; the exit code is 1 if a check failed.

    Raises:
        InputError: the engine is unknown.
        RunError: the engine is not installed.
    """
    engine, width = load_engine(name), max(map(len, CHECKS))
    if engine.find() is None:
        raise RunError(f"{name}: {engine.absence}")
    print(f"{'check':<{width}} {'verdict':<7} {'measured':>9} {'allowed':>9} {'s':>6}")
    rows = []
    for row in judge(engine, runs / name):
        verdict = row.verdict.upper() if row.verdict == FAIL else row.verdict
        numbers = " " * 19 if isnan(row.value) else f"{row.value:9.2g} {row.limit:9.2g}"
        words = row.words.partition("\n")[0]
        print(f"{row.check:<{width}} {verdict:<7} {numbers} {row.seconds:6.1f}  {words}", flush=True)
        rows.append(row)
    print(*_summary(rows), sep="\n")
    for row in rows if runs == paths.RUNS else ():  # elsewhere, plans do not look for it
        if entry := row.words.partition("\n")[2]:
            keep(name, build_of(engine, runs / name), Cost(**tomllib.loads(entry)[name]))
    if results:
        write_table(results / f"engine-{name}.csv", Row, rows)
    return 1 if any(row.verdict == FAIL for row in rows) else 0


def _summary(rows: list[Row]) -> Iterator[str]:
    """Lines below the table: entry for the table of costs, number of checks passed, check closest to its limit."""
    for row in rows:
        _, _, entry = row.words.partition("\n")
        if entry:
            where = f"as an entry of {paths.shown(paths.COSTS)}; for own engines no file has to be edited"
            yield f"\nmeasured cost, kept for plans and batches ({where}):\n{entry}\n"
    if any(row.verdict == NOT_RUN for row in rows):
        yield "not run: the adapter refuses the scene or has no such part, by design; this is no failure"
    counts = ", ".join(f"{sum(row.verdict == each for row in rows)} {each}" for each in (PASS, FAIL, NOT_RUN))
    measured = [row for row in rows if row.verdict == PASS and row.limit > 0]
    nearest = max(measured, key=lambda row: row.value / row.limit, default=None)
    closest = f"; closest to its limit: {nearest.check}, {nearest.value:.2g} of {nearest.limit:.2g}" if nearest else ""
    if any(row.verdict == FAIL and row.check.startswith("scene: ") for row in rows):
        yield f"for a diagnosis: python -m validation compare fig4 --engine {rows[0].engine}"
    yield f"{len(rows)} checks in {sum(row.seconds for row in rows):.0f} s: {counts}{closest}"
