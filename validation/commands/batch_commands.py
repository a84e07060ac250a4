"""Commands that run the cases of a study, and print how that went: ``batch``, ``status``, ``show``."""

import shutil
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.processes import cores
from drivers.base.terminal import counted, in_words, text_table
from drivers.base.tolerances import tolerance
from drivers.batch.job_array import job_script, print_job, run_job
from drivers.batch.rows import ENDED, Batch, Row, expected_s, rows_of, run_all, run_rows
from drivers.batch.store import Store
from drivers.batch.study import column_name
from drivers.chain.trace import FORCE, digest_of
from drivers.engines import entry_files, load_engine
from drivers.limits import refuse
from drivers.run.execute import LOCAL, Place, check_dask, get_ready
from drivers.run.run import run_case
from postproc.read.observables import describe, not_shown, observe
from validation.accuracy.budget import assess
from validation.accuracy.plan import plan_case
from validation.commands.run_commands import Words, show_run

STATES = ("done", "failed", "timeout", "refused", "stale", "claimed", "to do", "not installed")  # of a row
MAX_CASES = 20_000  # more need --yes
MAX_LINES = 20  # on failed rows


def batch_of(
    study: str | Path, runs: Path, engines: Sequence[str] = (), patterns: Sequence[str] = (), **more: Any
) -> Batch:
    """Batch of a study that takes plans and observables from here; ``more`` are fields of ``Batch``."""
    more |= {"plan": plan_case, "observe": observe, "entries": entry_files()}
    return Batch(study, runs.absolute(), tuple(engines), tuple(patterns), **more)


def batch(
    study: str, engines: Words, patterns: Words, runs: Path, results: Path, *, workers: int | None = None,
    dry_run: bool, retry: bool, yes: bool, part: tuple[int, int] | None = None, dask: str,
    slurm: bool, slices: int | None = None, lines: Words, wait: bool,
) -> int:  # fmt: skip
    """Run the missing cases of a study and write its table.

    Examples:
      beads batch sensitivity
      beads batch wall-material --engine verlet --workers 2 --dry-run
      beads batch sensitivity --slurm --wait
    """
    asked = batch_of(study, runs, engines, patterns, retry=retry, elsewhere=slurm, part=part or (1, 1))
    where, count = asked.study.where, asked.study.count
    for name, key in asked.study.columns.items():
        column = column_name(name, key)
        if (known := describe(column)).kind and column.endswith(known.ending):
            found = f'"{column}", the name of an observable'
            raise InputError(where, "axis", found, "another name of the column")
    if part:
        _print_absences(asked)
        print(f"slice {part[0]}/{part[1]}")
        with Store(asked.runs) as store:
            run_all(asked, store)
            return _print_states(asked, store, rows_of(asked, store, asked.numbers))
    if slurm and not dry_run and shutil.which("sbatch") is None:
        raise InputError("--slurm", "", "sbatch not found; run this on a machine that submits to Slurm")
    if count > MAX_CASES and not yes:
        raise InputError(where, "axis", f"{count:,} cases", f"at most {MAX_CASES:,}, or --yes")
    place = Place(workers or cores(), processes=not dask, dask=dask)
    if dask:
        check_dask(dask)
    elif not (slurm or dry_run):
        get_ready(run_rows, asked.plan, asked.observe)
    sample = asked.check_sample()  # the other cases are planned and refused when they run
    _print_absences(asked)
    with Store(asked.runs) as store:
        store.merge()
        if dry_run:
            workers = 1 if slurm or place.dask not in ("", LOCAL) else place.workers
            expected = expected_s(asked, store, asked.todo(store), sample)
            time = "not known yet" if expected is None else f"{in_words(expected / workers)} with {workers} at work"
            print(f"{asked.study.name}: {len(sample)} of {count} cases checked", *_states(asked, store), sep="\n")
            print(f"expected time: {time}; nothing has been run")
            if slurm:
                print_job(*job_script(asked, store, sample, slices, lines))
            return 0
        if any(asked.todo(store).values()):
            store.note_study(asked.study.path)
        while True:
            todo = asked.todo(store)
            with _followed(asked, store, todo) as tick:
                if slurm and any(todo.values()):
                    for _ in run_job(*job_script(asked, store, sample, slices, lines)):
                        if not wait:
                            print("when the jobs have ended, the same command without --slurm writes the table")
                            return 0
                        tick()
                    asked = replace(asked)  # its rows may be the first of their build
                elif any(todo.values()):
                    run_all(asked, store, place, tick)
            rows = rows_of(asked, store)
            if not store.damaged:
                return _write(asked, store, rows, results)
            print(f"{len(store.damaged)} damaged rows in {paths.shown(store.common)}: run again", file=sys.stderr)
            store.remove_damaged()


@contextmanager
def _followed(batch: Batch, store: Store, todo: dict[str, list[int]]) -> Iterator[Callable[[], None]]:
    """Yield a function that shows progress by the rows that are stored.

    Raises:
        KeyboardInterrupt: says how many rows are done, and how to go on.
    """
    ends = dict[Path, int]()
    store.written(batch.study.name, ends)
    with counted(batch.study.name, sum(map(len, todo.values())), "row") as count:

        def tick() -> None:
            count(store.written(batch.study.name, ends))

        try:
            yield tick
            tick()
        except KeyboardInterrupt as interrupt:
            goes_on = "the same command continues"
            if batch.elsewhere:
                goes_on = "the job continues; the same command without --slurm writes the table when it has ended"
            states = [state for states in batch.states(store).values() for state in states.values()]
            done = f"{states.count('done')} of {len(states)} rows done"
            raise KeyboardInterrupt(f"{done}; {goes_on}") from interrupt
        finally:
            store.release()  # of workers that were killed


def _write(batch: Batch, store: Store, rows: Sequence[Row], results: Path) -> int:
    """Write the tables of a study and print the number of rows in each state; returns the exit code."""
    from drivers.batch.tables import observables, write_tables  # pandas takes long to load

    study = batch.study
    for path in write_tables(batch, rows, results):
        print(paths.shown(path))
    done = [row for _, row in rows if row.done]
    names = [*observables(batch, done)]
    for line in not_shown(names, [row.values for row in done]):
        print(line)
    code = _print_states(batch, store, rows)
    limit = tolerance("truncation", FORCE).limit
    useless = Counter(row.engine for row in done if (row.force_error_share or 0.0) > limit)
    for name, count in useless.items():
        warning = f"{count} rows have force errors above {limit:g} of the largest change (force_error_share)"
        print(f"{name} warning: {warning}", file=sys.stderr)
    for glob in study.file.observables if done else ():
        if not any(fnmatchcase(name, glob) for name in names):
            print(f'{study.where}: observables: "{glob}" matches no observable', file=sys.stderr)
            code = max(code, 1)
    return code


def status(study: str, engines: Words, patterns: Words, runs: Path, every: bool) -> None:
    """Count the rows of a study by state.

    Example:
      beads status sensitivity --list
    """
    asked = batch_of(study, runs, engines, patterns)
    with Store(asked.runs) as store:
        if every:
            by_engine = asked.states(store)
            for number in asked.numbers:
                text = ", ".join(f"{name} {states[number]}" for name, states in by_engine.items())
                print(f"{number}: {asked.study.label(number)}: {text}")
        print(*_states(asked, store), sep="\n")


def show(study: str, case: int, engines: Words, runs: Path) -> int:
    """Write one case of a study as run folders with their decks.

    Example:
      beads show wall-material 3 --engine lammps
    """
    asked = batch_of(study, runs, engines)
    if not 1 <= case <= asked.study.count:
        raise InputError(f"case {case}", "", f"{asked.study.where} has cases 1 to {asked.study.count}")
    built = asked.case(case)
    print(f"case {case}: {asked.study.label(case)}")
    _print_absences(asked)
    code = int(len(asked.runnable) < len(asked.engines))
    with Store(asked.runs) as store:
        rows = {row.engine: row for _, row in rows_of(asked, store, [case])}
    for name in asked.runnable:
        if not asked.study.file.unsafe:
            refuse(built, name, override="unsafe = true in the study")
        ended, row = assess(run_case(built, name, asked.runs, limit_s=asked.study.file.limit), built), rows[name]
        same = ended.done and row.done and digest_of(ended.trace) == row.trace_sha256
        code = max(code, not show_run(ended), row.done and not same)
        print("  as in the batch, bit for bit" if same else f"  not as in the batch, where it is {row.status}")
    return code


def _print_absences(batch: Batch) -> None:
    """Print how to get each engine that is not installed."""
    for name in batch.engines:
        if name not in batch.here:
            print(f"{name}: {load_engine(name).absence}", file=sys.stderr)


def _states(batch: Batch, store: Store) -> list[str]:
    """Table with the number of the selected rows in each state, by engine."""
    counts = {name: Counter(states.values()) for name, states in batch.states(store).items()}
    return text_table(
        (name, ", ".join(f"{of[state]} {state}" for state in STATES if of[state])) for name, of in counts.items()
    )


def _print_states(batch: Batch, store: Store, rows: Sequence[Row]) -> int:
    """Print the number of the selected rows in each state, and a line for each that failed.

    Returns:
        Exit code: 2 if a row is refused, 1 if one is not done, else 0.
    """
    print(*_states(batch, store), sep="\n", flush=True)
    numbers = {*batch.numbers}
    missed = [row for number, row in rows if not row.done and number in numbers and row.engine in batch.engines]
    failed = [row for row in missed if row.status in ENDED]
    for row in failed[:MAX_LINES]:
        print(f"{row.label}: {row.engine} {row.status}: {row.reason}", file=sys.stderr)
    if failed:
        print(f"failed rows: {len(failed)}; --retry runs them again", file=sys.stderr)
    return 2 if any(row.status == "refused" for row in failed) else int(bool(missed))
