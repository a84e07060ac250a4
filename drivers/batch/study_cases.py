"""Cases of a study with their decks, and the identities by which finished rows are found.

Facts of cases are computed once and kept until something that they depend on changes.
"""

import hashlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path

from drivers.base.decks import Deck
from drivers.base.kept import content_of, digest_of_sources
from drivers.base.tolerances import tolerance
from drivers.batch.store import Store
from drivers.batch.study import Study, read_study, select
from drivers.chain.case import Case, Layout
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, installed, load_engine
from drivers.engines._entries import entry_files, use_entries
from drivers.limits.energy_bounds import needed_tolerance
from drivers.limits.refusal import inability, refuse
from drivers.run.build import Build, build_of
from drivers.run.run import run_identity

MAX_BODIES_OF_KEPT_DECKS = 1000  # decks of longer chains are rendered again, to save memory


@dataclass(frozen=True)
class Request:
    """Request of a study, by a command line or a scheduler; workers in other processes get it.

    Attributes:
        source: path of the study file, or name in ``inputs/studies``.
        runs: runs folder, the same for all workers.
        plan: function that returns a case with the time step planned for its accuracy.
        observe: function that returns observables by name, from a layout and a trace.
        residual: function that returns the largest force difference of two traces at each sample, divided by the
            largest change of force of the second.
        engines: selected engines, also beyond the study; if empty, the engines of the study.
        patterns: patterns that select cases; if empty, all cases.
        retry: True to run failures again that ended before ``asked``.
        asked: time of the request, in seconds of Unix time.
        entries: ``engines.toml`` files, for workers in other folders or on other machines.
    """

    source: str | Path
    runs: Path
    plan: Callable[[Case], Case]
    observe: Callable[[Layout, Trace], Mapping[str, float]]
    residual: Callable[[Trace, Trace], Array]
    engines: tuple[str, ...] = ()
    patterns: tuple[str, ...] = ()
    retry: bool = False
    asked: float = field(default_factory=time.time)
    entries: tuple[Path, ...] = ()


@dataclass(frozen=True, eq=False)
class Batch:
    """Requested study with everything else that identifies its rows, and the store of these rows.

    Attributes:
        request: the request.
        study: the study.
        engines: selected engines, in the order of the study.
        numbers: numbers of the selected cases.
        builds: builds of the installed engines and of the reference, by engine.
        readers: digests of everything that turns raw output into a row, by engine: sources, adapter, tolerances.
        store: store of the rows.
    """

    request: Request
    study: Study
    engines: tuple[str, ...]
    numbers: Sequence[int]
    builds: dict[str, Build]
    readers: dict[str, str]
    store: Store

    @cached_property
    def digest(self) -> str:
        """Digest of study, builds and adapters; results in the cache depend on everything else in any case."""
        adapters = {file for name in self.builds for file in _adapter_file(name)}
        templates = {template for file in adapters for template in file.parent.rglob("*.j2")}
        words = (f"{self.study!r}", f"{sorted(self.builds.items())}", f"{sorted(self.readers.items())}")
        return _digest("\0".join((*words, content_of((*adapters, *templates)))))

    def is_to_run(self, identity: str) -> bool:
        """True if a row is missing, or is a failure to be run again."""
        row, request = self.store.rows.get(identity), self.request
        return row is None or (request.retry and not row.done and row.ended < request.asked)

    def slice_of(self, part: int, parts: int) -> Sequence[int]:
        """Numbers of the selected cases of a part (from 1), interleaved so that all parts cost about the same."""
        return self.numbers[part - 1 :: parts]

    def case(self, number: int) -> "StudyCase":
        """Build a case of the study with its identities on all engines.

        Raises:
            InputError: the scene is wrong, or an engine refuses the case (``drivers.limits.refusal``).
        """
        study, builds = self.study, self.builds
        case = self.request.plan(study.case(number))
        case = replace(case, reference_tolerance=needed_tolerance(case))
        # the exact motion, for errors, is known for straight chains only
        names = [name for name in builds if name in study.engines or inability(case, name) is None]
        if not study.file.unsafe:
            for name in names:
                refuse(case, name, override="unsafe = true in the study")
        decks = {name: load_engine(name).render(case) for name in names}
        runs = {name: run_identity(name, builds[name], deck.sha256) for name, deck in decks.items()}
        gauges = f"{case.layout}\0{builds[REFERENCE].version}"
        identities = {name: _digest(f"{run}\0{gauges}\0{self.readers[name]}")[:20] for name, run in runs.items()}
        kept = decks if case.chain.bodies < MAX_BODIES_OF_KEPT_DECKS else {}
        return StudyCase(number, study.label(number), case, kept, runs, identities)


@lru_cache(maxsize=2)  # a request differs from all earlier ones by its time
def opened(request: Request, *, whole: bool = False) -> Batch:
    """Batch of a requested study on its installed engines.

    ``whole`` includes the engines of the study that are not selected.

    Raises:
        InputError: anything wrong with the study, its base scene or the selection.
    """
    if request.entries not in ((), entry_files()):  # a worker in another folder or on another machine
        use_entries(request.entries)
    study = read_study(request.source, request.engines)
    numbers = select(study, request.patterns)
    engines = tuple(name for name in study.engines if name in request.engines or not request.engines)
    builds, readers = {}, {}
    guards = [tolerance("guard", each).limit for each in ("energy", "impacts", "rounding", "friction", "least")]
    for name in dict.fromkeys((*installed(study.engines if whole else engines), REFERENCE)):
        engine = load_engine(name)
        builds[name] = build_of(engine)
        adapter = content_of(_adapter_file(name))
        readers[name] = _digest(f"{digest_of_sources()}\0{adapter}\0{engine.server.sha256}\0{guards}")
    return Batch(request, study, engines, numbers, builds, readers, Store(request.runs))


@dataclass(frozen=True)
class StudyCase:
    """Case of a study.

    Attributes:
        number: number of the case, from 1.
        label: label of the case.
        case: the case.
        kept_decks: decks by engine; empty for long chains.
        runs: identities of the runs by engine, as in names of run folders; without the reference if it cannot model the
            case.
        identities: identities of the rows by engine, from the run, the gauges and the sources that observe them.
    """

    number: int
    label: str
    case: Case
    kept_decks: dict[str, Deck]
    runs: dict[str, str]
    identities: dict[str, str]

    def wanted(self, identities: set[str]) -> list[str]:
        """Engines whose rows have one of these identities."""
        return [name for name, identity in self.identities.items() if identity in identities]


def _adapter_file(engine: str) -> list[Path]:
    """File of an adapter outside this project, as a list of one; empty for the adapters of this project."""
    adapter = load_engine(engine).entry.adapter
    return [Path(adapter)] if adapter.endswith(".py") else []


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
