"""Rows of a study: cases are planned, run and stored, by any number of processes, each of which may be killed."""

import json
import os
import pickle
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache, cached_property, lru_cache, partial
from itertools import chain, product
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import paths
from drivers.base.cache import content_of, digest_of_sources
from drivers.base.errors import InputError, RunError
from drivers.base.files import sha256_in
from drivers.base.processes import UNKNOWN_VERSION, private_temporary_folder
from drivers.base.tolerances import tolerance
from drivers.batch.store import Store, StudyRow
from drivers.batch.study import Study, read_study, select
from drivers.chain.case import Case, Layout
from drivers.chain.chain import Array, arrays_of
from drivers.chain.schemes import exact_motion
from drivers.chain.trace import FORCE, Trace, digest_of, largest_change_N
from drivers.engines import REFERENCE, Engine, entry_files, installed, load_engine
from drivers.limits import inability, needed_tolerance, refuse
from drivers.run.build import Build, build_of, names_of
from drivers.run.compute import compute
from drivers.run.execute import Place, execute
from drivers.run.run import run_identity
from drivers.scene.read_scene import find_input

MAX_CHUNK = 64  # cases that are claimed together
CHUNKS = 16  # of a worker, so that all end at about the same time
RETRY_INTERVAL_S = 1.0  # while another batch works on the remaining cases
ENDED = ("done", "failed", "timeout", "refused")  # states of rows that are not run again
WORKER_COSTS = ("start_s", "engine_s", "workflow_s", "reference_s")  # they add up to a worker's time
_last_exact: dict[bytes, Array] = {}  # forces of the last run of the reference, by _motion
NEWEST = 1000  # rows of an engine by which its build and its costs are known

Row = tuple[int, StudyRow]  # number of a case, and a row of it


@dataclass(frozen=True)
class Batch:
    """Study as a command line or a scheduler asks for it, with everything else that identifies its rows.

    Workers in other processes get what is asked, and read the study themselves.

    Attributes:
        source: path of the study file, or name in ``inputs/studies``.
        runs: runs folder, the same for all workers.
        selected: selected engines, also beyond the study; if empty, the engines of the study.
        patterns: patterns that select cases; if empty, all cases.
        part: I and N of part I of N of these cases, interleaved so that all parts cost about the same.
        retry: True to run failures again that ended before ``asked``.
        asked: time of the request, in seconds of Unix time.
        entries: ``engines.toml`` files, for workers in other folders or on other machines.
        elsewhere: True if the rows will be run where the engines that are not installed here are.
        plan: function of a higher package that returns a case with the time step planned for its accuracy.
        observe: function of a higher package that returns observables by name, from a layout and a trace. A batch that
            runs nothing has no need of the two.
    """

    source: str | Path
    runs: Path
    selected: tuple[str, ...] = ()
    patterns: tuple[str, ...] = ()
    part: tuple[int, int] = (1, 1)
    retry: bool = False
    asked: float = field(default_factory=time.time)
    entries: tuple[Path, ...] = ()
    elsewhere: bool = False
    plan: Callable[[Case], Case] = lambda case: case
    observe: Callable[[Layout, Trace], Mapping[str, float]] = lambda layout, trace: {}

    def __getstate__(self) -> dict[str, Any]:
        """Fields as they were asked, without all that is read; for processes that may have another working folder."""
        source = find_input(self._source, paths.STUDIES, "study").absolute()
        return {asked.name: getattr(self, asked.name) for asked in fields(self)} | {"source": source}

    @cached_property
    def study(self) -> Study:
        """The study.

        Raises:
            InputError: anything wrong with the study or its base scene.
        """
        return read_study(self._source, self.selected)

    @property
    def _source(self) -> str | Path:
        """The source, or the path of a study of that name that was run into this folder."""
        with Store(self.runs) as store:
            return store.path_of(self.source)

    @cached_property
    def numbers(self) -> Sequence[int]:
        """Numbers of the selected cases.

        Raises:
            InputError: no case matches.
        """
        first, step = self.part
        return select(self.study, self.patterns)[first - 1 :: step]

    @cached_property
    def engines(self) -> tuple[str, ...]:
        """Selected engines, in the order of the study."""
        return tuple(name for name in self.study.engines if name in self.selected or not self.selected)

    @cached_property
    def here(self) -> tuple[str, ...]:
        """Engines of the study that are installed here."""
        return installed(self.study.engines)

    def absent(self, name: str) -> str:
        """State of a missing row of an engine, which can be run here, or elsewhere, or not at all."""
        return "to do" if self.elsewhere or name in self.here else "not installed"

    @property
    def runnable(self) -> list[str]:
        """Selected engines whose rows can be run."""
        return [name for name in self.engines if self.absent(name) == "to do"]

    @cached_property
    def builds(self) -> dict[str, Build]:
        """Builds of the study's engines and of the reference, by engine."""
        engines = map(load_engine, dict.fromkeys((*self.study.engines, REFERENCE)))
        known = (*self.here, REFERENCE)
        return {each.name: build_of(each) if each.name in known else self._build_elsewhere(each) for each in engines}

    def _build_elsewhere(self, engine: Engine) -> Build:
        """Build of the newest row of an engine by a command of its entry; failed rows count only without a row done."""
        commands = {names_of(command) for command in engine.entry.command}
        with Store(self.runs) as store:
            rows = sorted(store.newest(engine.name, NEWEST), key=lambda row: row.done, reverse=True)
        builds = (build for row in rows if (build := Build.of_identity(row.build)).command in commands)
        return next(builds, Build((), UNKNOWN_VERSION, ""))

    @cached_property
    def programs(self) -> dict[str, str]:
        """Digests of everything besides the case that determines a row, by engine."""
        limits = [tolerance("model", quantity).limit for quantity in (FORCE, "motion", "level")]
        common = (digest_of_sources(), self.builds[REFERENCE].version, limits, self.study.file.unsafe)
        programs = {}
        for name, build in self.builds.items():
            engine = load_engine(name)
            program = common, build.identity, engine.server.sha256, content_of(_templates(engine))
            programs[name] = sha256_in(repr(program))[:32]
        return programs

    def case(self, number: int) -> Case:
        """Planned case with the tolerance of its reference.

        Raises:
            InputError: the case is wrong.
        """
        case = self.plan(self.study.case(number))
        return replace(case, reference_tolerance=needed_tolerance(case))

    def states(self, store: Store, numbers: Sequence[int] | None = None) -> dict[str, dict[int, str]]:
        """States of the selected or other cases by engine and number, without building a case.

        A failure that is to be run again counts as a missing row.
        """
        numbers = self.numbers if numbers is None else numbers
        cases = self.study.digests(numbers)
        claimed = store.claimed()  # first, since a row that is finished meanwhile loses its claim
        rows = store.states(cases, self.programs)

        def state(case: str, name: str) -> str:
            row = rows.get((case, name))
            current = row is not None and row.program == self.programs[name]
            if row and current and (row.done or not self.retry or row.ended >= self.asked):
                return row.status
            if (case, name) in claimed:
                return "claimed"
            return "stale" if row and not current else self.absent(name)

        return {
            name: {number: state(case, name) for number, case in zip(numbers, cases, strict=True)}
            for name in self.engines
        }

    def todo(self, store: Store) -> dict[str, list[int]]:
        """Numbers of the selected cases to run, by engine; without engines that are not runnable."""
        states = self.states(store)
        return {
            name: [number for number in self.numbers if states[name][number] not in ENDED] for name in self.runnable
        }

    def check_sample(self) -> list[Case]:
        """Build a sample of the cases, which is returned; the others are checked when they run.

        Raises:
            InputError: a scene is wrong, or an engine cannot model it.
        """
        cases = [self.study.case(number) for number in self.study.sample]
        for case, name in product(cases, self.engines):
            if cannot := inability(case, name):
                raise cannot
        return cases


@lru_cache(maxsize=2)
def _first(batch: Batch) -> Batch:
    """First of equal batches, which has read the study: workers get a batch with each chunk of cases."""
    return batch


def _templates(engine: Engine) -> Iterable[Path]:
    """Templates of a code, with an adapter outside this project; none for an in-repo engine."""
    adapter = Path(engine.entry.adapter)
    if adapter.suffix == ".py":
        return [adapter, *adapter.parent.rglob("*.j2")]
    return () if engine.in_repository else paths.TEMPLATES.rglob("*.j2")


def run_all(batch: Batch, store: Store, place: Place | None = None, tick: Callable[[], None] = lambda: None) -> None:
    """Run the unfinished rows of a batch, until they are stored by this or another batch.

    Args:
        batch: the batch.
        store: store of the rows.
        place: worker processes or a Dask cluster; None for this process.
        tick: function called several times a second while others work.

    Raises:
        InputError: the study is wrong.
        RunError: workers were killed repeatedly.
        OSError: the disk is full or the runs folder cannot be written to.
    """
    work, numbers = partial(run_rows, batch), sorted({*chain.from_iterable(batch.todo(store).values())})
    while numbers:
        size = max(1, min(MAX_CHUNK, len(numbers) // (CHUNKS * ((place and place.workers) or 1))))
        chunks = [numbers[start : start + size] for start in range(0, len(numbers), size)]
        left = [claimed for _, claimed in execute(work, chunks, place, tick)] if place else map(work, chunks)
        numbers = [*chain.from_iterable(left)]
        if numbers:  # another batch works on them
            time.sleep(RETRY_INTERVAL_S)


def run_rows(batch: Batch, numbers: Sequence[int]) -> list[int]:
    """Run the unfinished rows of some cases, which are claimed together and planned one by one.

    Engines that are not installed are skipped.

    Returns:
        Numbers of the cases with a row on which another process is working.

    Raises:
        InputError: other users could change temporary files, which no row would be to blame for.
        OSError: the disk is full or the runs folder cannot be written to.
    """
    if batch.entries not in ((), entry_files()):  # a worker in another folder or on another machine
        os.environ[paths.ENGINES_VARIABLE] = os.pathsep.join(map(str, batch.entries))
    batch = _first(batch)
    if not all(load_engine(name).in_repository for name in batch.runnable):
        private_temporary_folder()
    with Store(batch.runs) as store:
        cases = batch.study.digests(numbers)
        store.claim(cases, batch.runnable)
        states = batch.states(store, numbers)
        for number, case_sha256 in zip(numbers, cases, strict=True):
            names = [name for name in batch.runnable if states[name][number] in ("to do", "stale")]
            names.sort(key=lambda name: name != REFERENCE)  # the first, since others need its forces
            case = cache(partial(batch.case, number))
            for name in names:
                build, label = batch.builds[name].identity, batch.study.label(number)
                of_case = case_sha256, name, batch.programs[name], batch.study.name, label, build
                blank = StudyRow(*of_case, ended=time.time(), status="refused")
                try:
                    row = _row(batch, store, case(), blank)
                except (InputError, RunError) as error:  # refused, or failed in its adapter
                    row = replace(blank, status=getattr(error, "status", "refused"), reason=str(error))
                store.finish(row)
    return [number for number in numbers if any(states[name][number] == "claimed" for name in batch.runnable)]


def _exact_force_N(batch: Batch, case: Case) -> Array:
    """Forces of the reference, which engines and cases of equal motions share if they follow each other.

    Raises:
        ArithmeticError: the reference fails.
    """
    if (motion := _motion(case)) not in _last_exact:
        _last_exact.clear()
        time_s = np.arange(case.scene.samples, dtype=float) * case.scene.run.sample_interval  # as in its deck
        exact = exact_motion(case, case.reference_tolerance, time_s, limit_s=batch.study.file.limit)
        _last_exact[motion] = exact.force_N
    return _last_exact[motion]


def _motion(case: Case) -> bytes:
    """All that the forces of the reference depend on."""
    times = case.scene.samples, case.scene.run.sample_interval
    return pickle.dumps((vars(arrays_of(case.chain)), case.reference_tolerance, times))


def _row(batch: Batch, store: Store, case: Case, blank: StudyRow) -> StudyRow:
    """Row of a case on an engine, with its error against the reference; a row of equal numbers is copied.

    If the reference fails, the row fails, too. Three-dimensional cases have no reference and no error.

    Raises:
        InputError: the case is refused.
    """
    began, name = time.perf_counter(), blank.engine
    if not batch.study.file.unsafe:
        refuse(case, name, override="unsafe = true in the study")
    deck = load_engine(name).render(case)
    layout = case.layout
    identity = sha256_in(repr((run_identity(name, batch.builds[name], deck.sha256), layout, blank.program)))[:32]
    if equal := store.equal(identity):
        return replace(equal, **{key: getattr(blank, key) for key in ("case_sha256", "study", "label", "ended")})
    ended = compute(case, name, build=batch.builds[name], deck=deck, limit_s=batch.study.file.limit)
    trace, fault, force_error, reference_s = ended.trace, ended.fault, None, 0.0
    if name == REFERENCE and trace is not None:
        _last_exact.clear()
        _last_exact[_motion(case)] = trace.force_N
    elif trace is not None and inability(case, REFERENCE) is None:
        before = time.perf_counter()
        try:
            exact_N = _exact_force_N(batch, case)
            force_error = float(np.abs(trace.force_N - exact_N).max() / largest_change_N(exact_N))
        except ArithmeticError as error:
            status = "timeout" if isinstance(error.__context__, TimeoutError) else "failed"
            fault = RunError(f"the reference failed, so the error is unknown: {error}", status)
        reference_s = time.perf_counter() - before
    values = {} if trace is None else batch.observe(layout, trace)
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


def rows_of(batch: Batch, store: Store, numbers: Sequence[int] | None = None, *, stale: bool = False) -> list[Row]:
    """Rows of some or all cases of a study on its engines, with ``stale`` also stale ones; blank ones where missing."""
    study = batch.study
    numbers = range(1, study.count + 1) if numbers is None else numbers
    cases = dict(zip(numbers, study.digests(numbers), strict=True))
    rows = store.rows([*cases.values()], batch.programs)
    counted = {key: row for key, row in rows.items() if stale or row.program == batch.programs.get(row.engine)}
    return [
        (number, counted.get((case, name)) or StudyRow(case, name, "", study.name, "", "", 0.0, batch.absent(name)))
        for number, case in cases.items()
        for name in study.engines
    ]


def expected_s(batch: Batch, store: Store, todo: dict[str, list[int]], sample: Sequence[Case]) -> float | None:
    """Expected time in s of one worker for some cases by engine; None without any finished row of an engine.

    A row costs as much as the newest rows of its study, or else of its engine in proportion to bodies times steps.
    """
    seconds, work = 0.0, sum(case.work for case in sample) / len(sample)
    for engine, numbers in todo.items():
        if not numbers:
            continue
        rows = [row for row in store.newest(engine, NEWEST) if row.engine_s is not None]
        if not rows:
            return None
        of_study = [row for row in rows if row.study == batch.study.name]
        spent_s = sum(getattr(row, name) or 0.0 for row in of_study or rows for name in WORKER_COSTS)
        alike = len(of_study) or sum(row.bodies_times_steps or 0 for row in rows) / work
        seconds += len(numbers) * spent_s / alike
    return seconds
