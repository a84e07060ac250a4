"""Commands ``batch``, ``status`` and ``show``."""

import shlex
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import InputError, RunError, printable
from drivers.base.processes import cores
from drivers.base.progress import counted, in_words, say
from drivers.base.text_table import text_table
from drivers.base.tolerances import tolerance
from drivers.batch.job_array import job_script, most_tasks, parts_for, submit, waiting_for
from drivers.batch.store import StudyRow
from drivers.batch.study_cases import STATES, Batch, Request, expected_s, opened, validate_cases
from drivers.batch.study_rows import run_all, run_rows, run_slice
from drivers.chain.case import Case
from drivers.chain.trace import FORCE, digest_of
from drivers.engines import load_engine
from drivers.run.execute import LOCAL, Place, check_dask, get_ready
from drivers.run.run import run_case
from drivers.run.run_folder import EndedRun

MAX_NAMES = 3  # of damaged files in a message
MAX_CASES = 20_000  # more need --yes


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
        get_ready(run_rows, request.plan, request.observe)
    planned = _planned(request, place.workers, yes=yes)
    todo = planned.todo()
    absent = [name for name in planned.engines if name not in planned.here]
    if array and absent:
        print(f"not installed here, assumed to exist in the job: {', '.join(absent)}", flush=True)
    if dry_run:
        return _print_plan(planned, todo, place, array)
    study, store = planned.study, planned.store
    numbers = sorted({number for some in todo.values() for number in some})
    if numbers:
        awaited = {(study.name, name, study.label(n)): n for name, some in todo.items() for n in some}
        try:
            with _following(planned, awaited) as tick:
                if array:
                    path, text, _ = _job_script(planned, todo, numbers, array)
                    job = submit(path, text)
                    for _ in waiting_for(job) if array.wait else ():
                        tick()
                else:
                    run_all(replace(request, source=study.path), numbers, place, store, tick)
        except KeyboardInterrupt as interrupt:
            store.refresh()
            goes_on = "the same command continues"
            if array:
                goes_on = "the job continues; the same command without --slurm writes the table when it has ended"
            raise KeyboardInterrupt(f"{planned.progress()}; {goes_on}") from interrupt
        if array and not array.wait:
            print("when the jobs have ended, the same command without --slurm writes the table")
            return 0
        if array and absent:  # their rows may be the first of their build
            opened.cache_clear()
            planned = _planned(request, place.workers, yes=True)
    from drivers.batch.study_table import not_shown, unmatched, write_tables

    kept = None
    try:
        for path in write_tables(planned, results):
            print(paths.shown(path))
        if study.file.figure:
            there = ["--results", paths.shown(results)] if results != paths.RESULTS else []
            draw = ["beads", "study", str(request.source), *there]
            print(f"to draw the table: {shlex.join(draw)}")
        for line in not_shown(planned):
            print(line)
    except RunError as error:
        kept = error
    code = _print_end(planned)
    print(planned.progress())
    if kept:
        print(kept, file=sys.stderr)
        code = 1
    for pattern in unmatched(planned):
        print(f'{study.where}: observables: "{pattern}" matches no observable', file=sys.stderr)
        code = 1
    return code


def run_part(request: Request, part: int, parts: int) -> int:
    """Run part I of N of a study; returns the exit code."""
    batch = opened(request)
    rows = run_slice(request, batch.slice_of(part, parts))
    failures = [row for row in rows if not row.done]
    print(f"slice {part}/{parts}: {len(rows) - len(failures)} rows done, {len(failures)} failed")
    for row in failures:
        print(failure_line(row.label, row), file=sys.stderr)
    absent = [name for name in batch.engines if name not in batch.here]
    for name in absent:
        print(f"{name}: {load_engine(name).absence}", file=sys.stderr)
    return 1 if failures or absent else 0


def status(request: Request, *, every: bool = False) -> int:
    """Print the number of rows in each state; with ``every`` also each case."""
    batch = _planned(request, cores(), yes=True)
    if every:
        by_engine = batch.states()
        for number in batch.numbers:
            text = ", ".join(f"{name} {states[number]}" for name, states in by_engine.items())
            sys.stdout.write(f"{number}: {batch.study.label(number)}: {text}\n")
    _print_end(batch)
    return 0


def show(request: Request, number: int, assess: Callable[[EndedRun, Case], EndedRun]) -> int:
    """Run a case in run folders with their decks, and compare the results with the rows of the batch.

    ``assess`` measures the errors of a finished run.
    """
    batch = opened(request)
    study, store = batch.study, batch.store
    if not 1 <= number <= study.count:
        raise InputError(f"case {number}", "", f"{study.where} has cases 1 to {study.count}")
    store.refresh()
    case, identities = batch.case(number), batch.facts(number).identities
    print(f"case {number}: {study.label(number)}")
    code = 0
    for name in batch.engines:
        if name not in batch.here:
            print(f"{name}: not installed", file=sys.stderr)
            code = 1
            continue
        ended = assess(run_case(case, name, request.runs, limit_s=study.file.limit), case)
        row = store.rows.get(identities[name])
        for warning in ended.record.warnings or ():
            print(f"{name} warning: {warning}", file=sys.stderr)
        folder = paths.shown(ended.folder)
        if not ended.done:
            verdict, bad = f"{ended.record.status}: {ended.record.reason}", True
        elif row is None or not row.done:
            state = "not run" if row is None else row.status
            verdict, bad = f"{state} in the batch, so there is nothing to compare with", False
        else:
            bad = digest_of(ended.trace) != row.trace_sha256
            verdict = "differs from the batch" if bad else "as in the batch, bit for bit"
        print(f"{folder}  {verdict}", file=sys.stderr if bad else sys.stdout)
        code = 1 if bad else code
    return code


def _planned(request: Request, workers: int, *, yes: bool) -> Batch:
    """Read and plan a study; this validates every case."""
    batch = opened(request)
    study, store = batch.study, batch.store
    if study.count > MAX_CASES and not yes:
        raise InputError(study.where, "axis", f"{study.count:,} cases", f"at most {MAX_CASES:,}, or --yes")
    validate_cases(batch, workers)
    store.refresh()
    if store.damaged:
        count, names = len(store.damaged), ", ".join(map(printable, sorted(store.damaged)[:MAX_NAMES]))
        where = f"{paths.shown(store.folder)}: {names}{', ...' * (count > MAX_NAMES)}"
        print(f"{count} damaged file{'s' * (count > 1)} in {where}: ignored, may be removed", file=sys.stderr)
    return batch


def _job_script(batch: Batch, todo: dict[str, list[int]], numbers: list[int], array: JobArray) -> tuple[Path, str, int]:
    """File and text of the script of the Slurm job array for some cases, and the number of its tasks."""
    cases, limit = len(batch.numbers), most_tasks()
    parts = min(array.parts or parts_for(cases, expected_s(batch, todo)), cases)
    if parts > limit:
        print(f"{parts} tasks cut to {limit}, the limit of job arrays here (MaxArraySize)")
    return job_script(batch, numbers, min(parts, limit), array.lines)


def _print_plan(batch: Batch, todo: dict[str, list[int]], place: Place, array: JobArray | None) -> int:
    elsewhere = place.dask not in ("", LOCAL)
    workers = 1 if array or elsewhere else place.workers
    cases = len(batch.numbers)
    print(f"{batch.study.name}: {cases} case{'s' * (cases != 1)}, all valid")
    rows: list[tuple[str, str]] = []
    for name in batch.engines:
        some, state = batch.missing(name), "not installed"
        if name in todo:
            time_s = expected_s(batch, {name: some})
            state = "to do, cost not measured yet" if time_s is None else f"to do, about {in_words(time_s / workers)}"
        rows.append((f"  {name}", f"{cases - len(some)} done, {len(some)} {state if some else 'to do'}"))
    print(*text_table(rows), sep="\n")
    numbers = sorted({number for some in todo.values() for number in some})
    if array:
        path, text, tasks = _job_script(batch, todo, numbers or list(batch.numbers), array)
        print(f"\n{text}\nsbatch --parsable {shlex.quote(str(path))}")
        end = "nothing submitted" if numbers else "all rows are done, so without --dry-run it is not submitted"
        print(f"job array of {tasks} task{'s' * (tasks != 1)} with one worker each; {end}")
    elif elsewhere:
        print(f"times of one worker; on the Dask cluster at {place.dask}; nothing has been run")
    else:
        print(f"on {workers} worker{'s' * (workers != 1)}; nothing has been run")
    return 0


def _print_end(batch: Batch) -> int:
    """Print counts by engine, then failures; returns 1 unless all requested rows are done."""
    limit, numbers = tolerance("truncation", FORCE).limit, batch.numbers
    failures: list[str] = []
    code = 0
    done: list[tuple[str, str]] = []
    for name, states in batch.states().items():
        counts = Counter(states[number] for number in numbers)
        done.append((name, ", ".join(f"{counts[state]} {state}" for state in STATES if counts[state])))
        code = code if counts["done"] == len(numbers) else 1
        rows = batch.rows_of(name)
        failed = [(number, row) for number in numbers if (row := rows[number - 1]) and not row.done]
        failures += [failure_line(batch.study.label(number), row) for number, row in failed]
        useless = sum(row is not None and row.done and (row.force_error or 0.0) > limit for row in rows)
        if useless:
            warning = f"{useless} rows have force errors above {limit:g} of the largest change (force_error_share)"
            print(f"{name} warning: {warning}", file=sys.stderr)
    print(*text_table(done), sep="\n", flush=True)
    for line in failures:
        print(line, file=sys.stderr)
    if failures:
        print(f"{len(failures)} row{'s' * (len(failures) > 1)} failed; --retry runs them again", file=sys.stderr)
    return code


@contextmanager
def _following(batch: Batch, awaited: dict[tuple[str, str, str], int]) -> Iterator[Callable[[], None]]:
    """Yield a function that shows progress by the awaited rows (number of the case by study, engine and label).

    On a terminal it prints failures immediately.
    """
    with counted(batch.study.name, len(awaited), "row") as count:

        def tick() -> None:
            for row in batch.store.refresh():
                number = awaited.pop((row.study, row.engine, row.label), None)
                if number is not None:
                    count()
                    if not row.done and sys.stderr.isatty():  # else printed at the end
                        say(failure_line(batch.study.label(number), row))

        yield tick
        tick()


def failure_line(label: str, row: StudyRow) -> str:
    """One line for a failed row."""
    return f"{label}: {row.engine} {row.status}: {row.reason}"
