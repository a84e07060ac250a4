"""Commands ``batch``, ``status`` and ``show``."""

import shlex
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.progress import counted, in_words, say
from drivers.base.text_table import text_table
from drivers.base.tolerances import tolerance
from drivers.batch.job_array import JobArray, job_script, submit, waiting_for
from drivers.batch.rows import NEWEST, Batch, Methods, Request, opened, planned, run_all, run_rows, run_slice
from drivers.batch.store import Store, StudyRow
from drivers.chain.case import Case
from drivers.chain.trace import FORCE, digest_of
from drivers.engines import load_engine
from drivers.limits import refuse
from drivers.run.execute import LOCAL, Place, check_dask, get_ready
from drivers.run.run import run_case
from drivers.run.run_folder import EndedRun

STATES = ("done", "failed", "timeout", "refused", "stale", "claimed", "to do", "not installed")  # of a row
WORKER_COSTS = ("start_s", "engine_s", "workflow_s", "reference_s")  # they add up to a worker's time
MAX_CASES = 20_000  # more need --yes
MAX_LINES = 20  # on failed rows


def batch(
    request: Request,
    methods: Methods,
    results: Path,
    place: Place,
    array: JobArray | None = None,
    *,
    dry_run: bool = False,
    yes: bool = False,
) -> int:
    """Run the unfinished cases of a study and write its tables; returns the exit code.

    Cases are planned and refused when they run; before, the study and a sample of its cases are checked.

    Args:
        request: the study.
        methods: functions of higher packages.
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
        get_ready(place.workers, run_rows, methods.plan, methods.observe)
    batch = opened(request)
    study = batch.study
    if study.count > MAX_CASES and not yes:
        raise InputError(study.where, "axis", f"{study.count:,} cases", f"at most {MAX_CASES:,}, or --yes")
    sample = batch.check_sample()
    absent = [name for name in batch.engines if name not in batch.here]
    if array and absent:
        print(f"not installed here, assumed to exist in the job: {', '.join(absent)}", flush=True)
    with Store(request.runs) as store:
        store.merge()
        todo = batch.todo(store)
        if any(store.former.glob("*.jsonl")):
            print(f"{paths.shown(store.former)}: rows of an earlier version, not read; may be removed", file=sys.stderr)
        if store.damaged:
            print(f"{len(store.damaged)} damaged rows in {paths.shown(store.common)}: run again", file=sys.stderr)
        if dry_run:
            return _print_plan(batch, store, todo, sample, place, array)
        store.remove_damaged()
        numbers = sorted({number for some in todo.values() for number in some})
        if numbers:
            try:
                with _following(batch, store, sum(map(len, todo.values()))) as tick:
                    if array:
                        path, text, _ = job_script(batch, todo, sample, expected_s(batch, store, todo, sample), array)
                        job = submit(path, text)
                        for _ in waiting_for(job) if array.wait else ():
                            tick()
                    else:
                        run_all(replace(request, source=study.path), methods, numbers, place, tick)
            except KeyboardInterrupt as interrupt:
                goes_on = "the same command continues"
                if array:
                    goes_on = "the job continues; the same command without --slurm writes the table when it has ended"
                counts = Counter(state for states in batch.states(store).values() for state in states.values())
                done = f"{counts['done']} of {counts.total()} rows done"
                raise KeyboardInterrupt(f"{done}; {goes_on}") from interrupt
            finally:
                store.release()  # of workers that were killed
            if array and not array.wait:
                print("when the jobs have ended, the same command without --slurm writes the table")
                return 0
            if array and absent:  # their rows may be the first of their build
                opened.cache_clear()
                batch = opened(request)
        return _write(batch, methods, store, results)


def _write(batch: Batch, methods: Methods, store: Store, results: Path) -> int:
    """Write the tables of a study and print the number of rows in each state; returns the exit code."""
    from drivers.batch.tables import observed, rows_of, shown, write_tables  # pandas takes long to load

    study, rows = batch.study, rows_of(batch, store)
    for path in write_tables(batch, rows, results):
        print(paths.shown(path))
    if study.file.figure:
        given = (("--runs", batch.request.runs, paths.RUNS), ("--results", results, paths.RESULTS))
        folders = [word for option, folder, usual in given if folder != usual for word in (option, paths.shown(folder))]
        print(f"to draw the table: {shlex.join(['beads', 'study', str(batch.request.source), *folders])}")
    done = [row for *_, row in rows if row and row.done]
    for line in methods.not_shown(shown(batch, [*done]), [row.values for row in done]):
        print(line)
    selected = {*batch.numbers}
    failed = [
        row for number, name, row in rows if row and not row.done and number in selected and name in batch.engines
    ]
    code = max(_print_states(batch, store), _print_failures(failed))
    for name in study.engines:
        limit = tolerance("truncation", FORCE).limit
        useless = sum(row.engine == name and (row.force_error_share or 0.0) > limit for row in done)
        if useless:
            warning = f"{useless} rows have force errors above {limit:g} of the largest change (force_error_share)"
            print(f"{name} warning: {warning}", file=sys.stderr)
    print(f"{len(done)} of {len(rows)} rows done")
    names = observed([*done])
    for glob in study.file.observables if names else ():
        if not any(fnmatchcase(name, glob) for name in names):
            print(f'{study.where}: observables: "{glob}" matches no observable', file=sys.stderr)
            code = max(code, 1)
    return code


def run_part(request: Request, methods: Methods, part: int, parts: int) -> int:
    """Run part I of N of a study; returns the exit code."""
    batch = opened(request)
    numbers = batch.slice_of(part, parts)
    rows = run_slice(request, methods, numbers)
    failures = [row for row in rows if not row.done]
    print(f"slice {part}/{parts}: {len(rows) - len(failures)} rows done, {len(failures)} failed")
    code = _print_failures(failures)
    absent = [name for name in batch.engines if name not in batch.here]
    for name in absent:
        print(f"{name}: {load_engine(name).absence}", file=sys.stderr)
    return max(code, 1 if absent else 0)


def status(request: Request, *, every: bool = False) -> int:
    """Print the number of rows in each state; with ``every`` also each case."""
    batch = opened(request)
    with Store(request.runs) as store:
        if every:
            by_engine = batch.states(store)
            for number in batch.numbers:
                text = ", ".join(f"{name} {states[number]}" for name, states in by_engine.items())
                sys.stdout.write(f"{number}: {batch.study.label(number)}: {text}\n")
        _print_states(batch, store)
    return 0


def show(request: Request, methods: Methods, number: int, assess: Callable[[EndedRun, Case], EndedRun]) -> int:
    """Run a case in run folders with their decks, and compare the results with the rows of the batch.

    ``assess`` measures the errors of a finished run.
    """
    batch = opened(request)
    study = batch.study
    if not 1 <= number <= study.count:
        raise InputError(f"case {number}", "", f"{study.where} has cases 1 to {study.count}")
    case = planned(methods.plan(study.case(number)))
    print(f"case {number}: {study.label(number)}")
    code = 0
    for name in batch.engines:
        if name not in batch.here:
            print(f"{name}: not installed", file=sys.stderr)
            code = 1
            continue
        if not study.file.unsafe:
            refuse(case, name, override="unsafe = true in the study")
        ended = assess(run_case(case, name, request.runs, limit_s=study.file.limit), case)
        with Store(request.runs) as store:
            row = batch.rows(store, name, [number]).get(number)
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


def expected_s(batch: Batch, store: Store, todo: dict[str, list[int]], sample: Sequence[Case]) -> float | None:
    """Expected time in s of one worker for some cases by engine; None without any finished row of an engine.

    A row costs as much as the newest rows of its study, or else of its engine in proportion to bodies times steps.
    """
    seconds = 0.0
    for engine, numbers in todo.items():
        rows = [row for row in store.newest(engine, NEWEST) if row.engine_s is not None]
        of_study = [row for row in rows if row.study == batch.study.name]
        spent = sum(getattr(row, name) or 0.0 for row in of_study or rows for name in WORKER_COSTS)
        if numbers and not rows:
            return None
        if of_study:
            seconds += len(numbers) * spent / len(of_study)
        elif rows:
            work = sum(case.work for case in sample) / len(sample)
            seconds += len(numbers) * work * spent / sum(row.bodies_times_steps or 0 for row in rows)
    return seconds


def _print_plan(
    batch: Batch,
    store: Store,
    todo: dict[str, list[int]],
    sample: Sequence[Case],
    place: Place,
    array: JobArray | None,
) -> int:
    elsewhere = place.dask not in ("", LOCAL)
    workers = 1 if array or elsewhere else place.workers
    cases = len(batch.numbers)
    print(f"{batch.study.name}: {cases} case{'s' * (cases != 1)}; {len(sample)} of the study checked")
    rows: list[tuple[str, str]] = []
    for name in batch.engines:
        some, state = batch.missing(store, name, batch.numbers), "not installed"
        if name in todo:
            time_s = expected_s(batch, store, {name: some}, sample)
            state = "to do, cost not measured yet" if time_s is None else f"to do, about {in_words(time_s / workers)}"
        rows.append((f"  {name}", f"{cases - len(some)} done, {len(some)} {state if some else 'to do'}"))
    print(*text_table(rows), sep="\n")
    if array:
        path, text, tasks = job_script(batch, todo, sample, expected_s(batch, store, todo, sample), array)
        print(f"\n{text}\nsbatch --parsable {shlex.quote(str(path))}")
        end = "nothing submitted" if any(todo.values()) else "all rows are done, so it would not be submitted"
        print(f"job array of {tasks} task{'s' * (tasks != 1)} with one worker each; {end}")
    elif elsewhere:
        print(f"times of one worker; on the Dask cluster at {place.dask}; nothing has been run")
    else:
        print(f"on {workers} worker{'s' * (workers != 1)}; nothing has been run")
    return 0


def _print_states(batch: Batch, store: Store) -> int:
    """Print the number of selected rows in each state by engine; returns 1 unless all are done."""
    counts = {name: Counter(states.values()) for name, states in batch.states(store).items()}
    lines = [(name, ", ".join(f"{of[state]} {state}" for state in STATES if of[state])) for name, of in counts.items()]
    print(*text_table(lines), sep="\n", flush=True)
    return 0 if all(of["done"] == len(batch.numbers) for of in counts.values()) else 1


def _print_failures(rows: Sequence[StudyRow]) -> int:
    """Print a line for each failed or refused row; returns 2 if any is refused, else 1, or 0 without rows."""
    for line in dict.fromkeys(map(failure_line, rows[:MAX_LINES])):
        print(line, file=sys.stderr)
    if len(rows) > MAX_LINES:
        print(f"and {len(rows) - MAX_LINES} more, as in the column reason of the table", file=sys.stderr)
    if rows:
        print(f"{len(rows)} row{'s' * (len(rows) > 1)} failed; --retry runs them again", file=sys.stderr)
    return 2 if any(row.status == "refused" for row in rows) else 1 if rows else 0


@contextmanager
def _following(batch: Batch, store: Store, total: int) -> Iterator[Callable[[], None]]:
    """Yield a function that shows progress by the rows that are stored; on a terminal it prints failures at once."""
    position: dict[Path, int] = {}
    store.after(position)
    with counted(batch.study.name, total, "row") as count:

        def tick() -> None:
            for row in store.after(position):
                if row.study == batch.study.name:
                    count()
                    if not row.done and sys.stderr.isatty():  # else printed at the end
                        say(failure_line(row))

        yield tick
        tick()


def failure_line(row: StudyRow) -> str:
    """One line for a failed row; the reason of a refused one names its case."""
    return row.reason if row.status == "refused" else f"{row.label}: {row.engine} {row.status}: {row.reason}"
