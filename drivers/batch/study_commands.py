"""Commands ``batch``, ``status`` and ``show``."""

import shlex
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.processes import cores
from drivers.base.progress import counted, in_words, say
from drivers.base.text_table import text_table
from drivers.base.tolerances import tolerance
from drivers.batch.job_array import JobScript, job_script, parts_for, submit, waiting_for
from drivers.batch.store import WORK, Store, StudyRow
from drivers.batch.study_cases import Request, Setup, StudyPlan, opened
from drivers.batch.study_rows import plan_side_by_side, run_all, run_rows, run_slice
from drivers.run.execute import LOCAL, Place, check_dask, get_ready
from drivers.run.workplaces import leased

if TYPE_CHECKING:
    from drivers.chain.case import Case
    from drivers.run.run_folder import EndedRun

MAX_NAMES = 3  # of damaged files in a message
MAX_CASES = 20_000  # more need --yes
WORKER_COSTS = ("start_s", "engine_s", "workflow_s", "reference_s")  # they add up to a worker's time
STATES = ("done", "failed", "timeout", "stale", "claimed", "to do", "not installed")


@dataclass(frozen=True)
class JobArray:
    """Options of a Slurm job array.

    Attributes:
        wait: True to wait for the job array.
        parts: number of tasks; None for one by the expected time.
        lines: lines of the job's script before its command.
    """

    wait: bool = False
    parts: int | None = None
    lines: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Batch:
    """Requested study with its plan and stored rows."""

    setup: Setup
    plan: StudyPlan
    store: Store

    def todo(self) -> dict[str, list[int]]:
        """Numbers of the selected cases to run, by engine."""
        request, selection = self.setup.request, self.setup.selection
        return {
            name: [n for n in selection.numbers if request.is_to_run(self.store, identities[n - 1])]
            for name in selection.engines
            if (identities := self.plan.identities.get(name)) is not None
        }

    def progress(self) -> str:
        """Number of rows done in the whole table, as text."""
        study = self.setup.study
        rows = [row for name in study.engines for row in self.plan.rows_of(self.store, name)]
        return f"{sum(row is not None and row.done for row in rows)} of {study.count * len(study.engines)} rows done"

    def states(self) -> dict[str, dict[int, str]]:
        """States of all cases by engine and number."""
        claimed, label = leased(self.store.folder / WORK), self.setup.study.label

        def state(name: str, number: int) -> str:
            if name not in self.plan.identities:
                return "not installed"
            identity = self.plan.identities[name][number - 1]
            row = self.store.rows.get(identity)
            if row is not None:
                return row.status
            if identity in claimed:
                return "claimed"
            return "stale" if (self.setup.study.name, name, label(number)) in self.store.labels else "to do"

        numbers = range(1, self.setup.study.count + 1)
        return {name: {number: state(name, number) for number in numbers} for name in self.setup.selection.engines}


def batch(
    request: Request,
    results: Path,
    place: Place,
    array: JobArray | None = None,
    *,
    dry_run: bool = False,
    yes: bool = False,
) -> int:
    """Run the unfinished cases of a study and write its tables; returns the exit code.

    Args:
        request: the study.
        results: folder of the tables.
        place: worker processes of this machine, or a Dask cluster.
        array: options of a Slurm job array, which runs the cases instead; None for none.
        dry_run: True to plan only.
        yes: True to accept a study of many cases.
    """
    if array and not dry_run and shutil.which("sbatch") is None:
        raise InputError("--slurm", "", "sbatch not found; run this on a machine that submits to Slurm")
    if place.dask:
        check_dask(place.dask)
    if not (place.dask or array or dry_run):
        get_ready(run_rows, request.plan, request.observe, request.residual)
    found = _open(request, place.workers, yes=yes)
    todo = found.todo()
    if dry_run:
        return _print_plan(found, todo, place, array)
    study = found.setup.study
    numbers = sorted({number for some in todo.values() for number in some})
    if numbers:
        awaited = {found.plan.identities[name][n - 1]: n for name, some in todo.items() for n in some}
        try:
            with _following(found, awaited) as tick:
                if array:
                    job = submit(_job_script(found, todo, numbers, array))
                    for _ in waiting_for(job) if array.wait else ():
                        tick()
                else:
                    run_all(replace(request, source=study.path), numbers, place, found.store, tick)
        except KeyboardInterrupt as interrupt:
            found.store.refresh()
            goes_on = "the same command continues"
            if array:
                goes_on = "the job continues; the same command without --slurm writes the table when it has ended"
            raise KeyboardInterrupt(f"{found.progress()}; {goes_on}") from interrupt
        if array and not array.wait:
            print("when the jobs have ended, the same command without --slurm writes the table")
            return 0
    from drivers.batch.study_table import unmatched, write_tables

    kept = None
    try:
        for path in write_tables(study, found.plan, found.store, results):
            print(paths.shown(path))
        if study.file.figure:
            there = ["--results", paths.shown(results)] if results != paths.RESULTS else []
            draw = ["beads", "study", str(request.source), *there]
            print(f"to draw the table: {shlex.join(draw)}")
    except RunError as error:
        kept = error
    code = _print_end(found)
    print(found.progress())
    if kept:
        print(kept, file=sys.stderr)
        code = 1
    for pattern in unmatched(study, found.plan, found.store):
        print(f'{study.where}: observables: "{pattern}" matches no observable', file=sys.stderr)
        code = 1
    return code


def run_part(request: Request, part: int, parts: int) -> int:
    """Run part I of N of a study; returns the exit code."""
    rows = run_slice(request, opened(request)[0].selection.slice_of(part, parts))
    failures = [row for row in rows if not row.done]
    print(f"slice {part}/{parts}: {len(rows) - len(failures)} rows done, {len(failures)} failed")
    for row in failures:
        print(failure_line(row.label, row), file=sys.stderr)
    return 1 if failures else 0


def status(request: Request, *, every: bool = False) -> int:
    """Print the number of rows in each state; with ``every`` also each case."""
    found = _open(request, cores(), yes=True)
    if every:
        by_engine = found.states()
        for number in found.setup.selection.numbers:
            text = ", ".join(f"{name} {states[number]}" for name, states in by_engine.items())
            sys.stdout.write(f"{number}: {found.setup.study.label(number)}: {text}\n")
    _print_end(found)
    return 0


def show(request: Request, number: int, assess: Callable[["EndedRun", "Case"], "EndedRun"]) -> int:
    """Run a case in run folders with their decks, and compare the results with the rows of the batch.

    ``assess`` measures the errors of a finished run.
    """
    from drivers.chain.trace import digest_of
    from drivers.run.run import run_case

    setup, store = opened(request)
    study = setup.study
    if not 1 <= number <= study.count:
        raise InputError(f"case {number}", "", f"{study.where} has cases 1 to {study.count}")
    store.refresh()
    case = setup.case(number)
    print(f"case {number}: {case.label}")
    code = 0
    for name in setup.selection.engines:
        if name not in case.identities:
            print(f"{name}: not installed", file=sys.stderr)
            code = 1
            continue
        ended = assess(run_case(case.case, name, request.runs, limit_s=study.file.limit), case.case)
        row = store.rows.get(case.identities[name])
        for warning in ended.record.warnings or ():
            print(f"{name} warning: {warning}", file=sys.stderr)
        folder = paths.shown(ended.folder)
        if not ended.done:
            words, bad = f"{ended.record.status}: {ended.record.reason}", True
        elif row is None or not row.done:
            words, bad = f"{'not run yet' if row is None else row.status} in the batch", False
        else:
            bad = digest_of(ended.trace) != row.trace_sha256
            words = "differs from the batch" if bad else "as in the batch, bit for bit"
        print(f"{folder}  {words}", file=sys.stderr if bad else sys.stdout)
        code = 1 if bad else code
    return code


def _open(request: Request, workers: int, *, yes: bool) -> _Batch:
    """Read and plan a study; this validates every case."""
    setup, store = opened(request, whole=True)
    study = setup.study
    if study.count > MAX_CASES and not yes:
        raise InputError(study.where, "axis", f"{study.count:,} cases", f"at most {MAX_CASES:,}, or --yes")
    plan = plan_side_by_side(setup, workers)
    store.refresh()
    if store.damaged:
        count, names = len(store.damaged), ", ".join(sorted(store.damaged)[:MAX_NAMES])
        where = f"{paths.shown(store.folder)}: {names}{', ...' * (count > MAX_NAMES)}"
        print(f"{count} damaged file{'s' * (count > 1)} in {where}: ignored, may be removed", file=sys.stderr)
    return _Batch(setup, plan, store)


def _job_script(found: _Batch, todo: dict[str, list[int]], numbers: list[int], array: JobArray) -> JobScript:
    """Script of the Slurm job array for some cases."""
    cases = len(found.setup.selection.numbers)
    parts = array.parts or parts_for(cases, expected_s(found.plan, found.store, todo))
    return job_script(found.setup, found.store, numbers, parts, array.lines)


def _print_plan(found: _Batch, todo: dict[str, list[int]], place: Place, array: JobArray | None) -> int:
    elsewhere = place.dask not in ("", LOCAL)
    workers = 1 if array or elsewhere else place.workers
    cases = len(found.setup.selection.numbers)
    print(f"{found.setup.study.name}: {cases} case{'s' * (cases != 1)}, all valid")
    rows: list[tuple[str, str]] = []
    for name in found.setup.selection.engines:
        if name not in todo:
            rows.append((f"  {name}", "not installed"))
            continue
        some = todo[name]
        time_s = expected_s(found.plan, found.store, {name: some})
        expected = "cost not measured yet" if time_s is None else f"about {in_words(time_s / workers)}"
        rows.append((f"  {name}", f"{cases - len(some)} done, {len(some)} to do" + (f", {expected}" if some else "")))
    print(*text_table(rows), sep="\n")
    numbers = sorted({number for some in todo.values() for number in some})
    if array and numbers:
        script = _job_script(found, todo, numbers, array)
        print(f"\n{script.text}\nsbatch --parsable {shlex.quote(str(script.path))}")
        print(f"job array of {script.tasks} task{'s' * (script.tasks != 1)} with one worker each; nothing submitted")
    elif array:
        print("no job; nothing submitted")
    elif elsewhere:
        print(f"times of one worker; on the Dask cluster at {place.dask}; nothing has been run")
    else:
        print(f"on {workers} worker{'s' * (workers != 1)}; nothing has been run")
    return 0


def _print_end(found: _Batch) -> int:
    """Print counts by engine, then failures; returns 1 unless all requested rows are done."""
    limit, numbers = tolerance("warning", "force").limit, found.setup.selection.numbers
    failures: list[str] = []
    code = 0
    done: list[tuple[str, str]] = []
    for name, states in found.states().items():
        counts = Counter(states[number] for number in numbers)
        done.append((name, ", ".join(f"{counts[state]} {state}" for state in STATES if counts[state])))
        code = code if counts["done"] == len(numbers) else 1
        rows = found.plan.rows_of(found.store, name)
        failed = [(number, row) for number in numbers if (row := rows[number - 1]) and not row.done]
        failures += [failure_line(found.setup.study.label(number), row) for number, row in failed]
        useless = sum(row is not None and row.done and (row.force_error or 0.0) > limit for row in rows)
        if useless:
            words = f"{name} warning: {useless} rows have force errors above a tenth of the largest force"
            print(f"{words} (force_error_share)", file=sys.stderr)
    print(*text_table(done), sep="\n", flush=True)
    for line in failures:
        print(line, file=sys.stderr)
    if failures:
        print(f"{len(failures)} failed; --retry runs them again", file=sys.stderr)
    return code


@contextmanager
def _following(found: _Batch, awaited: dict[str, int]) -> Iterator[Callable[[], None]]:
    """Yield a function that shows progress by the awaited rows (number of the case by identity).

    On a terminal it prints failures immediately.
    """
    with counted(found.setup.study.name, len(awaited), "row") as count:

        def tick() -> None:
            for row in found.store.refresh():
                number = awaited.pop(row.identity, None)
                if number is not None:
                    count()
                    if not row.done and sys.stderr.isatty():  # else printed at the end
                        say(failure_line(found.setup.study.label(number), row))

        yield tick
        tick()


def failure_line(label: str, row: StudyRow) -> str:
    """One line for a failed row."""
    return f"{label}: {row.engine} {row.status}: {row.reason}"


def expected_s(plan: StudyPlan, store: Store, todo: dict[str, list[int]]) -> float | None:
    """Expected time in s of one worker for some cases by engine; None without any finished row.

    A row costs a constant plus a time proportional to bodies times steps; both are fitted to stored rows.
    """
    import numpy as np
    from scipy.optimize import nnls

    seconds = 0.0
    for engine, numbers in todo.items():
        if not numbers:
            continue
        rows = [row for row in store.rows.values() if row.engine == engine and row.cost.get("engine_s")]
        if not rows:
            return None
        spent = np.array([sum(row.cost[name] or 0.0 for name in WORKER_COSTS) for row in rows])
        work = np.array([float(row.work) for row in rows])
        scale = work.max() or 1.0
        each, rate = 0.0, spent.mean()
        if np.ptp(work):
            each, rate = nnls(np.column_stack([np.ones(len(work)), work / scale]), spent)[0]
        seconds += float(sum(each + rate * plan.work[number - 1] / scale for number in numbers))
    return seconds
