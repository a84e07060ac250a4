"""``batch``, ``status`` and ``show``: what the command line does with a study."""

import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.processes import cores
from drivers.base.tolerances import tolerance
from drivers.batch.leases import WORK, claimed
from drivers.batch.on_this_machine import get_ready, plan_here, plan_on, run_locally, worker_pool
from drivers.batch.selection import Selection, select
from drivers.batch.slices import run_slice
from drivers.batch.status import Progress, expected_s, in_words, states_on, told
from drivers.batch.store import Row, Store
from drivers.batch.study import Study, read_study
from drivers.batch.study_cases import plan_case, versions_of
from drivers.batch.study_plan import Plan, joined, keep_plan, kept_plan
from drivers.batch.worker import to_run

MANY = 20_000  # cases that nobody asks for by accident
MANY_TO_PLAN = 500  # from here on, workers share the planning
STATES = ("done", "failed", "stale", "running", "to do", "not installed")


@dataclass(frozen=True)
class Where:
    """Where a batch runs, and how.

    Attributes:
        workers: processes on this machine.
        dask: address of a scheduler, or ``local``.
        slurm: as a job array; ``wait``: until it is through; ``parts``: its tasks, None: by the time to expect.
    """

    workers: int
    dask: str | None = None
    slurm: bool = False
    wait: bool = False
    parts: int | None = None


@dataclass(frozen=True)
class _Opened:
    """A study with its plan, what is selected of it, and what the store has."""

    study: Study
    versions: dict[str, str]
    plan: Plan
    selection: Selection
    store: Store

    def todo(self, retry_before: float = 0.0) -> dict[str, list[int]]:
        """Numbers of the selected cases that are not done, by engine."""
        found: dict[str, list[int]] = {}
        for name in self.selection.engines:
            identities = self.plan.identities.get(name)
            if identities is not None:
                numbers = self.selection.numbers
                found[name] = [n for n in numbers if to_run(self.store, identities[n - 1], retry_before)]
        return found


def batch(
    source: str,
    runs: Path,
    results: Path,
    where: Where,
    *,
    engines: Sequence[str] = (),
    only: Sequence[str] = (),
    retry: bool = False,
    dry_run: bool = False,
    yes: bool = False,
) -> int:
    """Runs what is not done of a study and writes its tables; the exit code."""
    if where.slurm:
        from drivers.batch.on_slurm import must_have_slurm

        must_have_slurm()
    if not (where.dask or where.slurm or dry_run):
        get_ready()
    opened = _open(source, runs, engines, only, where.workers, yes=yes)
    retry_before = time.time() if retry else 0.0
    todo = opened.todo(retry_before)
    if dry_run:
        return _tell_plan(opened, todo, where.workers)
    numbers = sorted({number for some in todo.values() for number in some})
    submitted = False
    if numbers:
        identities = {opened.plan.identities[name][n - 1] for name, some in todo.items() for n in some}
        progress = Progress(opened.study, opened.plan, identities, opened.store)
        try:
            for _ in _run(opened, numbers, where, retry_before):
                progress.update()
            progress.update()
        finally:
            progress.close()
        submitted = where.slurm and not where.wait
    if submitted:
        print("once the jobs are through, the same command without --slurm writes the table")
        return 0
    from drivers.batch.study_table import unmatched, write_tables

    for path in write_tables(opened.study, opened.plan, opened.store, results):
        print(paths.shown(path))
    code = _tell_end(opened)
    for pattern in unmatched(opened.study, opened.plan, opened.store):
        print(f'{opened.study.where}: observables: nothing is called like "{pattern}"', file=sys.stderr)
        code = 1
    return code


def run_part(
    source: str, runs: Path, part: int, parts: int, engines: Sequence[str], only: Sequence[str], retry: bool
) -> int:
    """Runs part I of N of a study; the exit code."""
    rows = run_slice(Path(source), part, parts, runs, engines=engines, patterns=only, retry=retry)
    failures = [row for row in rows if not row.done]
    print(f"slice {part}/{parts}: {len(rows) - len(failures)} rows done, {len(failures)} failed")
    for row in failures:
        print(told(row.label, row), file=sys.stderr)
    return 1 if failures else 0


def status(
    source: str, runs: Path, *, engines: Sequence[str] = (), only: Sequence[str] = (), every: bool = False
) -> int:
    """Prints what is done, failed, stale, running and to do; ``every``: case by case."""
    opened = _open(source, runs, engines, only, cores(), yes=True)
    if every:
        lines = []
        running = claimed(opened.store.folder / WORK)
        by_engine = {
            name: dict(states_on(name, opened.study, opened.plan, opened.store, running))
            for name in opened.selection.engines
        }
        for number in opened.selection.numbers:
            said = ", ".join(f"{name} {states[number]}" for name, states in by_engine.items())
            lines.append(f"{number}: {opened.study.label(number)}: {said}\n")
        sys.stdout.write("".join(lines))
    _tell_end(opened)
    return 0


def show(source: str, number: int, runs: Path, engines: Sequence[str]) -> int:
    """Lays a case out as run folders with their decks, and says whether they are what the batch found."""
    from drivers.chain.trace import digest_of
    from drivers.run.run import run_case

    study, store = read_study(source), Store(runs)
    selection = select(study, engines, ())
    if not 1 <= number <= study.count:
        raise InputError(f"case {number}", "", f"no such case in {study.where}", f"1 to {study.count}")
    store.refresh()
    planned = plan_case(study, number, versions_of(selection.engines, runs))
    print(f"case {number}: {planned.label}")
    code = 0
    for name in selection.engines:
        if name not in planned.identities:
            print(f"{name}: not installed", file=sys.stderr)
            code = 1
            continue
        from validation.accuracy.assess import assess  # until it is handed in

        ended = assess(run_case(planned.case, name, runs, limit_s=study.limit_s), planned.case)
        row = store.rows.get(planned.identities[name])
        for warning in ended.record.warnings or ():
            print(f"{name} warning: {warning}", file=sys.stderr)
        if not ended.done:
            print(f"{paths.shown(ended.folder)}  {ended.record.status}: {ended.record.reason}", file=sys.stderr)
            code = 1
        elif row is None or not row.done:
            print(f"{paths.shown(ended.folder)}  {'not run yet' if row is None else row.status} in the batch")
        elif digest_of(ended.trace) == row.trace_sha256:
            print(f"{paths.shown(ended.folder)}  as in the batch, bit for bit")
        else:
            print(f"{paths.shown(ended.folder)}  differs from what the batch found", file=sys.stderr)
            code = 1
    return code


def _open(source: str, runs: Path, engines: Sequence[str], only: Sequence[str], workers: int, *, yes: bool) -> _Opened:
    """Reads a study and plans it, which validates every case."""
    study, store = read_study(source), Store(runs)
    if study.count > MANY and not yes:
        raise InputError(study.where, "axis", f"{study.count:,} cases", f"at most {MANY:,}, or --yes")
    selection = select(study, engines, only)
    versions = versions_of(study.engines, runs)
    plan = kept_plan(study, versions, store)
    if plan is None:
        plan = _planned(study, versions, store, workers)
        keep_plan(plan, study, versions, store)
    store.refresh()
    if store.damaged:
        count = len(store.damaged)
        print(f"{count} damaged file{'s' * (count > 1)} in {paths.shown(store.folder)}: left out", file=sys.stderr)
    return _Opened(study, versions, plan, selection, store)


def _planned(study: Study, versions: dict[str, str], store: Store, workers: int) -> Plan:
    from tqdm import tqdm

    if study.count < MANY_TO_PLAN or workers == 1:
        return plan_here(study, versions)
    parts = []
    with worker_pool(workers, study, store) as pool:
        bar = tqdm(total=study.count, unit="case", desc="validating", leave=False, disable=None, file=sys.stderr)
        for part in plan_on(pool, study, versions):
            parts.append(part)
            bar.update(len(part.work))
        bar.close()
    return joined(parts)


def _run(opened: _Opened, numbers: list[int], where: Where, retry_before: float) -> Iterator[None]:
    """Runs cases where they are to be run; yields now and then."""
    study, selection, store, retry = opened.study, opened.selection, opened.store, retry_before > 0
    if where.dask:
        from drivers.batch.on_dask import run_on_dask

        yield from run_on_dask(
            where.dask, study, selection, numbers, store.runs.resolve(), workers=where.workers, retry=retry
        )
    elif where.slurm:
        from drivers.batch.on_slurm import parts_for, submit, waiting_for, write_script

        parts = where.parts or parts_for(len(selection.numbers), _expected(opened, opened.todo(retry_before)))
        script = write_script(study, selection, numbers, store, parts, retry=retry)
        job = submit(script)
        print(f"job {job}: {paths.shown(script)}", flush=True)
        if where.wait:
            yield from waiting_for(job)
    else:
        yield from run_locally(study, numbers, selection.engines, opened.versions, store, where.workers, retry_before)


def _expected(opened: _Opened, todo: dict[str, list[int]]) -> float | None:
    """Seconds of one worker; None where an engine has never been measured."""
    times = [expected_s(opened.plan, opened.store, name, [n - 1 for n in some]) for name, some in todo.items()]
    known = [time_s for time_s in times if time_s is not None]
    return sum(known) if len(known) == len(times) else None


def _tell_plan(opened: _Opened, todo: dict[str, list[int]], workers: int) -> int:
    cases = len(opened.selection.numbers)
    print(f"{opened.study.name}: {cases} case{'s' * (cases != 1)}, all valid")
    for name in opened.selection.engines:
        if name not in todo:
            print(f"  {name:<10} not installed")
            continue
        some = todo[name]
        time_s = expected_s(opened.plan, opened.store, name, [n - 1 for n in some])
        expected = "cost not measured yet" if time_s is None else f"about {in_words(time_s / workers)}"
        print(f"  {name:<10} {cases - len(some)} done, {len(some)} to do" + (f", {expected}" if some else ""))
    print(f"on {workers} worker{'s' * (workers != 1)}; nothing has been run")
    return 0


def _useless(row: Row | None) -> bool:
    return row is not None and row.done and (row.force_error or 0.0) > tolerance("warning", "force").limit


def _tell_end(opened: _Opened) -> int:
    """Counts by engine, failures last; 1 unless all that was asked for is done."""
    running = claimed(opened.store.folder / WORK)
    failures: list[str] = []
    whole = True
    for name in opened.selection.engines:
        found = dict(states_on(name, opened.study, opened.plan, opened.store, running))
        states = Counter(found[number] for number in opened.selection.numbers)
        print(f"{name:<10} {', '.join(f'{states[state]} {state}' for state in STATES if states[state])}")
        whole = whole and states["done"] == len(opened.selection.numbers)
        rows = opened.plan.rows_of(opened.store, name) if name in opened.plan.identities else []
        if states["failed"]:
            failed = [number for number in opened.selection.numbers if found[number] == "failed"]
            failures += [told(opened.study.label(number), row) for number in failed if (row := rows[number - 1])]
        useless = sum(_useless(row) for row in rows)
        if useless:
            say = f"{name} warning: forces of {useless} rows are off by more than a tenth of the largest"
            print(f"{say} (force_error_share)", file=sys.stderr)
    for line in failures:
        print(line, file=sys.stderr)
    if failures:
        print(f"{len(failures)} failed; --retry runs them again", file=sys.stderr)
    return 0 if whole else 1
