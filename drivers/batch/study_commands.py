"""Commands ``batch``, ``status`` and ``show``."""

import itertools
import shlex
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.processes import cores
from drivers.base.progress import counted, in_words, say
from drivers.base.text_table import text_table
from drivers.base.tolerances import tolerance
from drivers.batch.store import WORK, Store, StudyRow
from drivers.batch.study import Selection, read_study, select
from drivers.batch.study_cases import Request, Setup, StudyPlan, keep_plan, kept_plan, set_up
from drivers.batch.worker import get_ready, plan_side_by_side, run_locally, run_slice, to_run
from drivers.run.workplaces import leased

if TYPE_CHECKING:
    from drivers.batch.on_clusters import JobScript
    from drivers.chain.case import Case
    from drivers.run.finished import EndedRun

MAX_CASES = 20_000  # more need --yes
WORKER_COSTS = ("start_s", "engine_s", "workflow_s", "reference_s")  # they add up to a worker's time
STATES = ("done", "failed", "timeout", "stale", "claimed", "to do", "not installed")


@dataclass(frozen=True)
class Where:
    """Options of a batch: workers, Dask or Slurm.

    Attributes:
        workers: number of processes on this machine.
        dask: address of a Dask scheduler, or ``local``.
        slurm: True for a Slurm job array.
        wait: True to wait for the job array.
        parts: number of tasks of the job array; None for one by the expected time.
        lines: lines of the job's script before its command.
    """

    workers: int
    dask: str | None = None
    slurm: bool = False
    wait: bool = False
    parts: int | None = None
    lines: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Batch:
    """Requested study with its plan, selection and stored rows."""

    request: Request
    setup: Setup
    plan: StudyPlan
    selection: Selection
    store: Store

    def todo(self) -> dict[str, list[int]]:
        """Numbers of the selected cases to run, by engine."""
        return {
            name: [
                n for n in self.selection.numbers if to_run(self.store, identities[n - 1], self.request.retry_before)
            ]
            for name in self.selection.engines
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
        return {name: {number: state(name, number) for number in numbers} for name in self.selection.engines}


def batch(request: Request, results: Path, where: Where, *, dry_run: bool = False, yes: bool = False) -> int:
    """Run the unfinished cases of a study and write its tables; returns the exit code."""
    if where.slurm and not dry_run and shutil.which("sbatch") is None:
        raise InputError("--slurm", "", "sbatch not found; run this on a machine that submits to Slurm")
    if where.dask:
        from drivers.batch.on_clusters import check_dask

        check_dask(where.dask)
    if not (where.dask or where.slurm or dry_run):
        get_ready(request.steps)
    found = _open(request, where.workers, yes=yes)
    todo = found.todo()
    if dry_run:
        return _print_plan(found, todo, where)
    study = found.setup.study
    numbers = sorted({number for some in todo.values() for number in some})
    if numbers:
        awaited = {found.plan.identities[name][n - 1]: n for name, some in todo.items() for n in some}
        try:
            _follow(_run(found, todo, numbers, where), found, awaited)
        except KeyboardInterrupt as interrupt:
            found.store.refresh()
            goes_on = "the same command continues"
            if where.slurm:
                goes_on = "the job continues; the same command without --slurm writes the table when it has ended"
            raise KeyboardInterrupt(f"{found.progress()}; {goes_on}") from interrupt
        if where.slurm and not where.wait:
            print("when the jobs have ended, the same command without --slurm writes the table")
            return 0
    from drivers.batch.study_table import unmatched, write_tables

    kept = None
    try:
        for path in write_tables(study, found.plan, found.store, results):
            print(paths.shown(path))
        if study.file.figure:
            place = ["--results", paths.shown(results)] if results != paths.RESULTS else []
            draw = ["python", "-m", "postproc", "study", str(found.request.source), *place]
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
    rows = run_slice(request, part, parts)
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
        for number in found.selection.numbers:
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

    study, runs = read_study(request.source, request.engines), request.runs
    store, selection = Store(runs), select(study, request.engines, ())
    if not 1 <= number <= study.count:
        raise InputError(f"case {number}", "", f"{study.where} has cases 1 to {study.count}")
    store.refresh()
    case = set_up(study, selection.engines, runs, request.steps).case(number)
    print(f"case {number}: {case.label}")
    code = 0
    for name in selection.engines:
        if name not in case.identities:
            print(f"{name}: not installed", file=sys.stderr)
            code = 1
            continue
        ended = assess(run_case(case.case, name, runs, limit_s=study.file.limit), case.case)
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
    study, store = read_study(request.source, request.engines), Store(request.runs)
    if study.count > MAX_CASES and not yes:
        raise InputError(study.where, "axis", f"{study.count:,} cases", f"at most {MAX_CASES:,}, or --yes")
    selection = select(study, request.engines, request.patterns)
    setup = set_up(study, study.engines, request.runs, request.steps)
    plan = kept_plan(setup, store)
    if plan is None:
        plan = plan_side_by_side(setup, store, workers)
        keep_plan(plan, setup, store)
    store.refresh()
    if store.damaged:
        count = len(store.damaged)
        print(f"{count} damaged file{'s' * (count > 1)} in {paths.shown(store.folder)}: ignored", file=sys.stderr)
    return _Batch(request, setup, plan, selection, store)


def _run(found: _Batch, todo: dict[str, list[int]], numbers: list[int], where: Where) -> Iterator[None]:
    """Run cases at the requested place; yields repeatedly."""
    setup, selection, store = found.setup, found.selection, found.store
    if where.dask:
        from drivers.batch.on_clusters import run_on_dask

        request = replace(found.request, source=setup.study.path, runs=store.runs.resolve())
        yield from run_on_dask(where.dask, request, selection, numbers, where.workers)
    elif where.slurm:
        from drivers.batch.on_clusters import submit, waiting_for

        job = submit(_job_script(found, todo, numbers, where))
        if where.wait:
            yield from waiting_for(job)
    else:
        yield from run_locally(setup, numbers, selection.engines, store, where.workers, found.request.retry_before)


def _job_script(found: _Batch, todo: dict[str, list[int]], numbers: list[int], where: Where) -> "JobScript":
    """Script of the Slurm job array for some cases."""
    from drivers.batch.on_clusters import job_script, parts_for

    selection, store = found.selection, found.store
    parts = where.parts or parts_for(len(selection.numbers), expected_s(found.plan, store, todo))
    return job_script(found.request, found.setup.study, selection, numbers, store, parts, where.lines)


def _print_plan(found: _Batch, todo: dict[str, list[int]], where: Where) -> int:
    workers = 1 if where.slurm or where.dask not in (None, "local") else where.workers
    cases = len(found.selection.numbers)
    print(f"{found.setup.study.name}: {cases} case{'s' * (cases != 1)}, all valid")
    rows: list[tuple[str, str]] = []
    for name in found.selection.engines:
        if name not in todo:
            rows.append((f"  {name}", "not installed"))
            continue
        some = todo[name]
        time_s = expected_s(found.plan, found.store, {name: some})
        expected = "cost not measured yet" if time_s is None else f"about {in_words(time_s / workers)}"
        rows.append((f"  {name}", f"{cases - len(some)} done, {len(some)} to do" + (f", {expected}" if some else "")))
    print(*text_table(rows), sep="\n")
    numbers = sorted({number for some in todo.values() for number in some})
    if where.slurm and numbers:
        script = _job_script(found, todo, numbers, where)
        print(f"\n{script.text}\nsbatch --parsable {shlex.quote(str(script.path))}")
        print(f"job array of {script.tasks} task{'s' * (script.tasks != 1)} with one worker each; nothing submitted")
    elif where.slurm:
        print("no job; nothing submitted")
    elif where.dask not in (None, "local"):
        print(f"times of one worker; on the Dask cluster at {where.dask}; nothing has been run")
    else:
        print(f"on {workers} worker{'s' * (workers != 1)}; nothing has been run")
    return 0


def _print_end(found: _Batch) -> int:
    """Print counts by engine, then failures; returns 1 unless all requested rows are done."""
    limit, numbers = tolerance("warning", "force").limit, found.selection.numbers
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


def _follow(under_way: Iterator[None], found: _Batch, awaited: dict[str, int]) -> None:
    """Show progress by the awaited rows (number of the case by identity), and failures on a terminal."""
    with counted(found.setup.study.name, len(awaited), "row") as count:
        for _ in itertools.chain(under_way, [None]):
            for row in found.store.refresh():
                number = awaited.pop(row.identity, None)
                if number is not None:
                    count()
                    if not row.done and sys.stderr.isatty():  # else printed at the end
                        say(failure_line(found.setup.study.label(number), row))


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
