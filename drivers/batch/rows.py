"""Rows of a study: cases are planned, run and stored, by any number of processes, each of which may be killed."""

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from math import isfinite
from pathlib import Path

from drivers.base import paths
from drivers.base.cache import content_of, digest_of_sources
from drivers.base.errors import InputError, RunError
from drivers.base.processes import UNKNOWN_VERSION, private_temporary_folder
from drivers.base.tolerances import tolerance
from drivers.batch.store import Store, StudyRow
from drivers.batch.study import Study, read_study, select
from drivers.chain.case import Case, Layout
from drivers.chain.trace import FORCE, Trace, digest_of, residual
from drivers.engines import REFERENCE, Engine, entry_files, installed, load_engine
from drivers.limits import inability, needed_tolerance, refuse
from drivers.run.build import Build, build_of, names_of
from drivers.run.compute import Computed, compute
from drivers.run.execute import Place, WorkersKilledError, execute
from drivers.run.run import run_identity

CHUNK = 64  # largest number of cases in a chunk
RETRY_INTERVAL_S = 2.0  # while another batch works on the remaining cases
MAX_DEATHS = 5  # of workers in a row, without a finished row
NEWEST = 1000  # rows of an engine by which its build and its costs are known


@dataclass(frozen=True)
class Request:
    """Request of a study, by a command line or a scheduler; workers in other processes get it.

    Attributes:
        source: path of the study file, or name in ``inputs/studies``.
        runs: runs folder, the same for all workers.
        engines: selected engines, also beyond the study; if empty, the engines of the study.
        patterns: patterns that select cases; if empty, all cases.
        retry: True to run failures again that ended before ``asked``.
        asked: time of the request, in seconds of Unix time.
        entries: ``engines.toml`` files, for workers in other folders or on other machines.
        elsewhere: True if the rows will be run where the engines that are not installed here are.
    """

    source: str | Path
    runs: Path
    engines: tuple[str, ...] = ()
    patterns: tuple[str, ...] = ()
    retry: bool = False
    asked: float = field(default_factory=time.time)
    entries: tuple[Path, ...] = ()
    elsewhere: bool = False


@dataclass(frozen=True)
class Methods:
    """Functions of higher packages that a batch calls.

    Attributes:
        plan: function that returns a case with the time step planned for its accuracy.
        observe: function that returns observables by name, from a layout and a trace.
        not_shown: function that returns lines on the observables that some rows do not show, with the reason, from
            names and the values of the rows.
    """

    plan: Callable[[Case], Case]
    observe: Callable[[Layout, Trace], Mapping[str, float]]
    not_shown: Callable[[Sequence[str], Sequence[Mapping[str, float]]], list[str]]


@dataclass(frozen=True, eq=False)
class Batch:
    """Requested study with everything else that identifies its rows.

    Attributes:
        request: the request.
        study: the study.
        engines: selected engines, in the order of the study.
        numbers: numbers of the selected cases.
        here: engines of the study that are installed here.
        runnable: those whose rows can be run; all engines of the study if the request is for rows run elsewhere.
        builds: builds of the study's engines and of the reference, by engine.
        programs: digests of everything besides the case that determines a row, by engine.
    """

    request: Request
    study: Study
    engines: tuple[str, ...]
    numbers: Sequence[int]
    here: tuple[str, ...]
    runnable: tuple[str, ...]
    builds: dict[str, Build]
    programs: dict[str, str]

    def slice_of(self, part: int, parts: int) -> Sequence[int]:
        """Numbers of the selected cases of a part (from 1), interleaved so that all parts cost about the same."""
        return self.numbers[part - 1 :: parts]

    def rows(self, store: Store, engine: str, numbers: Sequence[int], *, stale: bool = False) -> dict[int, StudyRow]:
        """Rows of cases on an engine by number, with ``stale`` also those of another program."""
        cases = [self.study.case_sha256(number) for number in numbers]
        rows, program = store.rows(engine, cases), self.programs[engine]
        found = ((number, rows.get(case)) for number, case in zip(numbers, cases, strict=True))
        return {number: row for number, row in found if row and (stale or row.program == program)}

    def missing(self, store: Store, engine: str, numbers: Sequence[int]) -> list[int]:
        """Numbers of cases without a row on an engine, or with a failure to be run again."""
        rows, request = self.rows(store, engine, numbers), self.request

        def is_missing(row: StudyRow | None) -> bool:
            return row is None or (request.retry and not row.done and row.ended < request.asked)

        return [number for number in numbers if is_missing(rows.get(number))]

    def todo(self, store: Store) -> dict[str, list[int]]:
        """Numbers of the selected cases to run, by engine; without engines that are not runnable."""
        return {name: self.missing(store, name, self.numbers) for name in self.engines if name in self.runnable}

    def states(self, store: Store) -> dict[str, dict[int, str]]:
        """States of the selected cases by engine and number, without building a case or reading a row."""
        cases = {number: self.study.case_sha256(number) for number in self.numbers}
        by_engine: dict[str, dict[int, str]] = {}
        for name in self.engines:
            states, claimed = store.states(name, [*cases.values()]), store.claimed(name, [*cases.values()])
            absent = "to do" if name in self.runnable else "not installed"
            current = {case: status for case, (status, program) in states.items() if program == self.programs[name]}
            by_engine[name] = {
                number: current.get(case) or ("claimed" if case in claimed else "stale" if case in states else absent)
                for number, case in cases.items()
            }
        return by_engine

    def check_sample(self) -> list[Case]:
        """Build a sample of the cases, which is returned; the others are checked when they run.

        Raises:
            InputError: a scene is wrong, or an engine cannot model it.
        """
        cases = [self.study.case(number) for number in self.study.sample]
        for case in cases:
            for name in self.engines:
                if cannot := inability(case, name):
                    raise cannot
        return cases


@lru_cache(maxsize=2)  # a request differs from all earlier ones by its time
def opened(request: Request) -> Batch:
    """Batch of a requested study.

    Raises:
        InputError: anything wrong with the study, its base scene or the selection.
    """
    if request.entries not in ((), entry_files()):  # a worker in another folder or on another machine
        os.environ[paths.ENGINES_VARIABLE] = os.pathsep.join(map(str, request.entries))
    study = read_study(request.source, request.engines)
    numbers = select(study, request.patterns)
    engines = tuple(name for name in study.engines if name in request.engines or not request.engines)
    here = installed(study.engines)
    limits = [tolerance("model", quantity).limit for quantity in (FORCE, "motion", "level")]
    common = (digest_of_sources(), build_of(load_engine(REFERENCE)).version, limits, study.file.unsafe)
    builds, programs = {}, {}
    for name in dict.fromkeys((*study.engines, REFERENCE)):
        engine = load_engine(name)
        builds[name] = build_of(engine) if name in (*here, REFERENCE) else _build_elsewhere(engine, request.runs)
        programs[name] = _digest((common, builds[name].identity, engine.server.sha256, content_of(_templates(engine))))
    return Batch(request, study, engines, numbers, here, study.engines if request.elsewhere else here, builds, programs)


def _build_elsewhere(engine: Engine, runs: Path) -> Build:
    """Build of the newest row of an engine by a command of its entry; failed rows count only without a row done."""
    commands = {names_of(command) for command in engine.entry.command}
    with Store(runs) as store:
        rows = sorted(store.newest(engine.name, NEWEST), key=lambda row: row.done, reverse=True)
    builds = (build for row in rows if (build := Build.of_identity(row.build)).command in commands)
    return next(builds, Build((), UNKNOWN_VERSION, ""))


def _templates(engine: Engine) -> Iterable[Path]:
    """Templates of a code, with an adapter outside this project; none for an in-repo engine."""
    adapter = Path(engine.entry.adapter)
    if adapter.suffix == ".py":
        return [adapter, *adapter.parent.rglob("*.j2")]
    return () if engine.in_repository else paths.TEMPLATES.rglob("*.j2")


def _digest(parts: object) -> str:
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:32]


def run_all(
    request: Request, methods: Methods, numbers: Sequence[int], place: Place, store: Store, tick: Callable[[], None]
) -> None:
    """Run the unfinished rows of cases, until they are stored by this or another batch.

    Args:
        request: the study.
        methods: functions of higher packages.
        numbers: numbers of the cases.
        place: worker processes or a Dask cluster.
        store: store of the rows.
        tick: function called several times a second.

    Raises:
        RunError: workers were killed repeatedly.
        OSError: the disk is full or the runs folder cannot be written to.
    """
    deaths, position = 0, dict[Path, int]()
    store.after(position)
    while numbers:
        try:
            under_way = execute(partial(run_rows, request, methods), _chunks(numbers, place.workers), place, tick)
            numbers = [number for _, left in under_way for number in left]
            if numbers:  # another batch works on them
                time.sleep(RETRY_INTERVAL_S)
        except WorkersKilledError:
            deaths = 0 if store.after(position) else deaths + 1
            if deaths == MAX_DEATHS:
                raise


def _chunks(numbers: Sequence[int], workers: int) -> Iterator[Sequence[int]]:
    """Chunks that get smaller towards the end, so that all workers end at the same time."""
    start = 0
    while start < len(numbers):
        size = max(1, min(CHUNK, (len(numbers) - start) // (4 * (workers or 1))))
        yield numbers[start : start + size]
        start += size


def run_slice(request: Request, methods: Methods, numbers: Sequence[int]) -> list[StudyRow]:
    """Run the unfinished rows of some cases in this process and return all their rows.

    Raises:
        InputError: the study is wrong.
        OSError: the disk is full or the runs folder cannot be written to.
    """
    batch, left = opened(request), numbers
    while left := run_rows(request, methods, left):  # another process works on them
        time.sleep(RETRY_INTERVAL_S)
    with Store(request.runs) as store:
        return [row for name in batch.engines for row in batch.rows(store, name, numbers).values()]


def run_rows(request: Request, methods: Methods, numbers: Sequence[int]) -> list[int]:
    """Run the unfinished rows of some cases of a study.

    Cases are claimed in chunks and planned one by one. Engines that are not installed are skipped.

    Returns:
        Numbers of the cases with a row on which another process is working.

    Raises:
        InputError: other users could change temporary files, which no row would be to blame for.
        OSError: the disk is full or the runs folder cannot be written to.
    """
    batch, left = opened(request), set[int]()
    runnable = [name for name in batch.engines if name in batch.runnable]
    if not all(load_engine(name).in_repository for name in runnable):
        private_temporary_folder()
    with Store(request.runs) as store:
        exact: dict[str, Computed] = {}
        for start in range(0, len(numbers), CHUNK):
            chunk = numbers[start : start + CHUNK]
            wanted: dict[int, list[str]] = {number: [] for number in chunk}
            for name in runnable:
                missing = {batch.study.case_sha256(number): number for number in batch.missing(store, name, chunk)}
                claimed = [missing[case] for case in store.claim(name, [*missing])] if missing else []
                for number in batch.missing(store, name, claimed):  # others may have run some before the claim
                    wanted[number].append(name)
                left |= {*missing.values()}.difference(claimed)
            for number, names in wanted.items():
                for row in _rows_of_case(batch, methods, store, number, names, exact) if names else ():
                    store.finish(row)
        left = {number for name in runnable for number in batch.missing(store, name, sorted(left))}
    return sorted(left)


def _rows_of_case(
    batch: Batch, methods: Methods, store: Store, number: int, names: Sequence[str], exact: dict[str, Computed]
) -> Iterator[StudyRow]:
    """Rows of a case on some engines; ``exact`` holds the last run of the reference, which cases may share."""
    study, case = batch.study, None
    for name in names:
        blank = StudyRow(
            study.case_sha256(number),
            name,
            batch.programs[name],
            study.name,
            study.label(number),
            batch.builds[name].identity,
            time.time(),
            "refused",
        )
        try:
            case = case or planned(methods.plan(study.case(number)))
            yield _row(batch, methods, store, case, blank, exact)
        except InputError as error:
            yield replace(blank, reason=str(error))
        except RunError as error:  # of the adapter, before the run
            yield replace(blank, status=error.status, reason=str(error))


def planned(case: Case) -> Case:
    """Planned case with the tolerance of its reference."""
    return replace(case, reference_tolerance=needed_tolerance(case))


def _row(
    batch: Batch, methods: Methods, store: Store, case: Case, blank: StudyRow, exact: dict[str, Computed]
) -> StudyRow:
    """Row of a case on an engine, with its error against the reference; a row of equal numbers is copied.

    If the reference fails, the row fails, too. Three-dimensional cases have no reference and no error.

    Raises:
        InputError: the case is refused.
    """
    began, name, limit_s = time.perf_counter(), blank.engine, batch.study.file.limit
    if not batch.study.file.unsafe:
        refuse(case, name, override="unsafe = true in the study")
    deck = load_engine(name).render(case)
    identity = _digest((run_identity(name, batch.builds[name], deck.sha256), case.layout, blank.program))
    if equal := store.equal(identity):
        return replace(equal, **{key: getattr(blank, key) for key in ("case_sha256", "study", "label", "ended")})

    def reference() -> Computed:
        deck = load_engine(REFERENCE).render(case)
        if deck.sha256 not in exact:
            exact.clear()
            exact[deck.sha256] = compute(case, REFERENCE, build=batch.builds[REFERENCE], deck=deck, limit_s=limit_s)
        return exact[deck.sha256]

    if name == REFERENCE:
        ended = reference()
    else:
        ended = compute(case, name, build=batch.builds[name], deck=deck, limit_s=limit_s)
    trace, fault, force_error, reference_s = ended.trace, ended.fault, None, 0.0
    if name != REFERENCE and trace is not None and inability(case, REFERENCE) is None:
        before = time.perf_counter()
        truth = reference()
        reference_s = time.perf_counter() - before
        if truth.fault is not None:
            fault = RunError(f"the reference failed, so the error is unknown: {truth.fault}", truth.fault.status)
        else:
            force_error = float(residual(trace, truth.done).max())
    values = {} if trace is None else methods.observe(case.layout, trace)
    digest = "" if trace is None else digest_of(trace)
    workflow_s = time.perf_counter() - began - ended.start_s - ended.wall_s - reference_s
    return replace(
        blank,
        identity=identity,
        status=fault.status if fault else "done",
        reason=str(fault) if fault else "",
        observables=json.dumps(
            {observable: float(value) if isfinite(value) else None for observable, value in values.items()},
            separators=(",", ":"),
        ),
        force_error_share=force_error,
        trace_sha256=digest,
        bodies_times_steps=case.work,
        start_s=ended.start_s,
        engine_s=ended.wall_s,
        loop_s=ended.loop_s,
        workflow_s=max(workflow_s, 0.0),
        reference_s=reference_s,
        ended=time.time(),
    )
