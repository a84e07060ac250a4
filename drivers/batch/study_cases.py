"""Cases of a study with their decks, the identities by which finished rows are found, and the planning of a batch.

Facts of cases are computed once and kept until something that they depend on changes.
"""

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base.kept import content_of, digest_of_sources, keep, recall
from drivers.base.processes import UNKNOWN_VERSION
from drivers.base.progress import counted
from drivers.base.tolerances import tolerance
from drivers.batch.store import WORK, Store, StudyRow
from drivers.batch.study import Study, column_name, read_study, select, value_at
from drivers.chain.case import Case, Layout
from drivers.chain.trace import FORCE, Trace
from drivers.engines import REFERENCE, Engine, installed, load_engine
from drivers.engines._entries import entry_files, use_entries
from drivers.limits import inability, needed_tolerance, refuse
from drivers.run.build import Build, build_of, names_of
from drivers.run.execute import Place, execute
from drivers.run.run import run_identity
from drivers.run.workplaces import leased

STATES = ("done", "failed", "timeout", "stale", "claimed", "to do", "not installed")  # of a row
WORKER_COSTS = ("start_s", "engine_s", "workflow_s", "reference_s")  # they add up to a worker's time
MIN_PARALLEL_CASES = 500  # from this number on, workers share the planning
CHUNK = 25  # facts of so many cases fit into one write; a worker killed between two writes would block the batch


@dataclass(frozen=True)
class Request:
    """Request of a study, by a command line or a scheduler; workers in other processes get it.

    Attributes:
        source: path of the study file, or name in ``inputs/studies``.
        runs: runs folder, the same for all workers.
        plan: function that returns a case with the time step planned for its accuracy.
        observe: function that returns observables by name, from a layout and a trace.
        engines: selected engines, also beyond the study; if empty, the engines of the study.
        patterns: patterns that select cases; if empty, all cases.
        retry: True to run failures again that ended before ``asked``.
        asked: time of the request, in seconds of Unix time.
        entries: ``engines.toml`` files, for workers in other folders or on other machines.
        elsewhere: True if the rows will be run where the engines that are not installed here are.
        not_shown: function that returns lines on the observables that some rows do not show, with the reason, from
            names and the values of the rows; None for no lines.
    """

    source: str | Path
    runs: Path
    plan: Callable[[Case], Case]
    observe: Callable[[Layout, Trace], Mapping[str, float]]
    engines: tuple[str, ...] = ()
    patterns: tuple[str, ...] = ()
    retry: bool = False
    asked: float = field(default_factory=time.time)
    entries: tuple[Path, ...] = ()
    elsewhere: bool = False
    not_shown: Callable[[Sequence[str], Sequence[Mapping[str, float]]], list[str]] | None = None


@dataclass(frozen=True)
class CaseFacts:
    """Facts of a valid case, kept until something that they depend on changes.

    Attributes:
        runs: identities of the runs by engine, as in names of run folders; without the reference if it cannot model the
            case.
        identities: identities of the rows by engine, from the run, the gauges and the sources that observe them.
        work: bodies times steps.
        values: varied values in SI units, in the order of the columns.
    """

    runs: dict[str, str]
    identities: dict[str, str]
    work: int
    values: list[Any]


@dataclass(frozen=True, eq=False)
class Batch:
    """Requested study with everything else that identifies its rows, and the store of these rows.

    Attributes:
        request: the request.
        study: the study.
        engines: selected engines, in the order of the study.
        numbers: numbers of the selected cases.
        here: engines of the study that are installed here.
        runnable: those whose rows can be run; all engines of the study if the request is for rows run elsewhere.
        builds: builds of the study's engines and of the reference, by engine.
        readers: digests of everything that turns raw output into a row, by engine: sources, adapter, tolerances.
        store: store of the rows.
        known: facts of cases that this process has read or computed, by number.
    """

    request: Request
    study: Study
    engines: tuple[str, ...]
    numbers: Sequence[int]
    here: tuple[str, ...]
    runnable: tuple[str, ...]
    builds: dict[str, Build]
    readers: dict[str, str]
    store: Store
    known: dict[int, CaseFacts] = field(default_factory=dict)

    @cached_property
    def digest(self) -> str:
        """Digest of study, builds and adapters; results in the cache depend on everything else in any case."""
        adapters = {file for name in self.builds for file in _adapter_file(name)}
        templates = {template for file in adapters for template in file.parent.rglob("*.j2")}
        parts = (self.study, sorted(self.builds.items()), sorted(self.readers.items()), content_of(templates))
        return _digest(repr(parts))

    @property
    def all_numbers(self) -> range:
        """Numbers of all cases of the study, selected or not."""
        return range(1, self.study.count + 1)

    def is_to_run(self, identity: str) -> bool:
        """True if a row is missing, or is a failure to be run again."""
        row, request = self.store.rows.get(identity), self.request
        return row is None or (request.retry and not row.done and row.ended < request.asked)

    def slice_of(self, part: int, parts: int) -> Sequence[int]:
        """Numbers of the selected cases of a part (from 1), interleaved so that all parts cost about the same."""
        return self.numbers[part - 1 :: parts]

    def case(self, number: int) -> Case:
        """Build a case of the study, with the time step for its accuracy and the tolerance of its reference.

        Raises:
            InputError: the scene is wrong.
        """
        case = self.request.plan(self.study.case(number))
        return replace(case, reference_tolerance=needed_tolerance(case))

    def facts(self, number: int) -> CaseFacts:
        """Facts of a case, from the cache or computed; raises as ``computed_facts``."""
        if number not in self.known and not self.recall_facts(self.chunks()[(number - 1) // CHUNK]):
            self.known[number] = self.computed_facts(number)
        return self.known[number]

    def computed_facts(self, number: int) -> CaseFacts:
        """Validate a case and compute its facts.

        Raises:
            InputError: the scene is wrong, or an engine refuses the case (``drivers.limits``).
        """
        study, case = self.study, self.case(number)
        # the exact motion, for errors, is known for straight chains only
        names = [name for name in self.builds if name in study.engines or inability(case, name) is None]
        if not study.file.unsafe:
            for name in names:
                refuse(case, name, override="unsafe = true in the study")
        runs = {name: run_identity(name, self.builds[name], load_engine(name).render(case).sha256) for name in names}
        gauges = f"{case.layout}\0{self.builds[REFERENCE].version}"
        identities = {name: _digest(f"{run}\0{gauges}\0{self.readers[name]}")[:20] for name, run in runs.items()}
        values = [value_at(case.scene, key) for key in study.columns.values()]
        return CaseFacts(runs, identities, case.work, values)

    def chunks(self) -> list[Sequence[int]]:
        """Numbers of all cases of the study, in chunks whose facts are kept together."""
        return [self.all_numbers[start : start + CHUNK] for start in range(0, self.study.count, CHUNK)]

    def recall_facts(self, chunk: Sequence[int]) -> bool:
        """Read facts of a chunk from the cache; False if there are none, or something they depend on has changed."""
        stored = recall(self._key_of(chunk)) or []
        self.known.update((number, CaseFacts(**values)) for number, values in zip(chunk, stored, strict=bool(stored)))
        return bool(stored)

    def keep_facts(self, chunk: Sequence[int]) -> list[CaseFacts]:
        """Compute and keep the facts of a chunk; raises as ``computed_facts``."""
        facts = [self.computed_facts(number) for number in chunk]
        return [CaseFacts(**values) for values in keep(self._key_of(chunk), [asdict(fact) for fact in facts])]

    @property
    def values(self) -> dict[str, list[Any]]:
        """Varied values of all cases in SI units, by column with its unit."""
        columns = [column_name(name, key) for name, key in self.study.columns.items()]
        return {
            name: [self.facts(number).values[place] for number in self.all_numbers]
            for place, name in enumerate(columns)
        }

    def rows_of(self, engine: str) -> list[StudyRow | None]:
        """Rows of an engine in the order of the cases; None for missing rows."""
        return [self.store.rows.get(self.facts(number).identities.get(engine, "")) for number in self.all_numbers]

    def todo(self) -> dict[str, list[int]]:
        """Numbers of the selected cases to run, by engine; without engines that are not runnable."""
        return {name: self.missing(name) for name in self.engines if name in self.runnable}

    def missing(self, engine: str) -> list[int]:
        """Numbers of the selected cases without a row of an engine, or with a failure to be run again."""
        return [number for number in self.numbers if self.is_to_run(self.facts(number).identities[engine])]

    def progress(self) -> str:
        """Number of rows done in the whole table, as text."""
        rows = [row for name in self.study.engines for row in self.rows_of(name)]
        return f"{sum(row is not None and row.done for row in rows)} of {len(rows)} rows done"

    def states(self) -> dict[str, dict[int, str]]:
        """States of all cases by engine and number, as named in ``STATES``."""
        claimed = leased(self.store.folder / WORK)

        def state(name: str, number: int) -> str:
            identity = self.facts(number).identities[name]
            row = self.store.rows.get(identity)
            if row is not None:
                return row.status
            if identity in claimed:
                return "claimed"
            if (self.study.name, name, self.study.label(number)) in self.store.labels:
                return "stale"
            return "to do" if name in self.runnable else "not installed"

        return {name: {number: state(name, number) for number in self.all_numbers} for name in self.engines}

    def _key_of(self, chunk: Sequence[int]) -> list[Any]:
        return ["cases of a study", self.digest, chunk[0], chunk[-1]]


@lru_cache(maxsize=2)  # a request differs from all earlier ones by its time
def opened(request: Request) -> Batch:
    """Batch of a requested study.

    Raises:
        InputError: anything wrong with the study, its base scene or the selection.
    """
    if request.entries not in ((), entry_files()):  # a worker in another folder or on another machine
        use_entries(request.entries)
    study = read_study(request.source, request.engines)
    numbers = select(study, request.patterns)
    engines = tuple(name for name in study.engines if name in request.engines or not request.engines)
    here, builds, readers, store = installed(study.engines), {}, {}, Store(request.runs)
    runnable = study.engines if request.elsewhere else here
    if here != study.engines:
        store.refresh()
    limits = [tolerance("model", quantity).limit for quantity in (FORCE, "motion", "level")]
    for name in dict.fromkeys((*study.engines, REFERENCE)):
        engine = load_engine(name)
        builds[name] = build_of(engine) if name in (*here, REFERENCE) else _build_elsewhere(engine, store)
        adapter = content_of(_adapter_file(name))
        readers[name] = _digest(f"{digest_of_sources()}\0{adapter}\0{engine.server.sha256}\0{limits}")
    return Batch(request, study, engines, numbers, here, runnable, builds, readers, store)


def validate_cases(batch: Batch, workers: int) -> None:
    """Read or compute the facts of all cases of a study, by several workers if it is large.

    The facts of each chunk of cases are kept when they are computed, so that planning continues after a kill.

    Raises:
        InputError: a case is wrong or refused.
    """
    left = [chunk for chunk in batch.chunks() if not batch.recall_facts(chunk)]
    under_way: Iterator[tuple[Sequence[int], list[CaseFacts]]]
    if len(left) * CHUNK < MIN_PARALLEL_CASES or workers == 1:
        under_way = ((chunk, batch.keep_facts(chunk)) for chunk in left)
    else:
        under_way = execute(partial(_keep_facts, batch.request), left, Place(workers, processes=True))
    with counted("cases validated", sum(map(len, left)), "case") as count:
        for chunk, facts in under_way:
            batch.known.update(zip(chunk, facts, strict=True))
            count(len(chunk))


def _keep_facts(request: Request, chunk: Sequence[int]) -> list[CaseFacts]:
    return opened(request).keep_facts(chunk)


def expected_s(batch: Batch, todo: dict[str, list[int]]) -> float | None:
    """Expected time in s of one worker for some cases by engine; None without any finished row.

    A row costs a constant plus a time proportional to bodies times steps; both are fitted to stored rows.
    """
    from scipy.optimize import nnls

    seconds = 0.0
    for engine, numbers in todo.items():
        if not numbers:
            continue
        rows = [row for row in batch.store.rows.values() if row.engine == engine and row.cost.get("engine_s")]
        if not rows:
            return None
        spent = np.array([sum(row.cost[name] or 0.0 for name in WORKER_COSTS) for row in rows])
        work = np.array([float(row.work) for row in rows])
        scale = work.max() or 1.0
        constant, rate = 0.0, spent.mean()
        if np.ptp(work):
            constant, rate = nnls(np.column_stack([np.ones(len(work)), work / scale]), spent)[0]
        seconds += float(sum(constant + rate * batch.facts(number).work / scale for number in numbers))
    return seconds


def _build_elsewhere(engine: Engine, store: Store) -> Build:
    """Build of the newest row of an engine by a command of its entry; failed rows count only without a row done."""
    rows = [row for row in store.rows.values() if row.engine == engine.name and row.build]
    rows.sort(key=lambda row: (row.done, row.ended), reverse=True)
    commands = {names_of(command) for command in engine.entry.command}
    builds = (build for row in rows if (build := Build.of_identity(row.build)).command in commands)
    return next(builds, Build((), UNKNOWN_VERSION, ""))


def _adapter_file(engine: str) -> list[Path]:
    """File of an adapter outside this project, as a list of one; empty for the adapters of this project."""
    adapter = load_engine(engine).entry.adapter
    return [Path(adapter)] if adapter.endswith(".py") else []


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
