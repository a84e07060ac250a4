"""A case on an engine: the only way in which a case becomes a trace.

An in-repo engine integrates in this process. The deck of a code runs in a process of its own if it has a folder of its
own or if that is asked for; else on a server process that runs one deck after another, since start-up dominates the
cost of small cases.
"""

import os
import resource
import threading
import time
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryFile, gettempdir

import numpy as np

from drivers.base.cache import load, store
from drivers.base.decks import Deck
from drivers.base.errors import RunError
from drivers.base.processes import STDERR, STDOUT, EndedProcess, private_temporary_folder, run_command, workplace
from drivers.chain.case import Case, build_case
from drivers.chain.schemes import default_limit_s, endable
from drivers.chain.trace import Trace, digest_of
from drivers.engines import Engine, load_engine
from drivers.run.build import Build, build_of
from drivers.run.guard import checked, checked_trace, timed_out
from drivers.run.session import lent
from drivers.scene.read_scene import read_scene
from validation.reference.hertz_chain import Flag

PROBE = ("fig4", ("run.duration=20 us", "run.time_step=0.1 us"))  # short run that tests servers
PROBE_BYTES = 1 << 24  # room without which a disk counts as full: Open MPI frees 8 MB as soon as a code has ended

_server_test = threading.Lock()


@dataclass(frozen=True)
class Computed:
    """End of a case on an engine.

    Attributes:
        trace: trace; None if the run failed.
        fault: reason of a failure, with a partial trace if there is one; else None.
        wall_s, cpu_s, memory_bytes: wall and CPU time of the case, and peak memory of its process; on a server CPU
            time and memory are 0.
        loop_s: time in the code's time loop; None if the run did not finish.
        start_s: time in which a server was started for this case.
    """

    trace: Trace | None
    fault: RunError | None
    wall_s: float
    cpu_s: float
    memory_bytes: int
    loop_s: float | None
    start_s: float = 0.0

    @property
    def done(self) -> Trace:
        """Trace of a run that succeeded.

        Raises:
            RunError: the run failed.
        """
        if self.trace is None:
            assert self.fault is not None
            raise self.fault
        return self.trace


def compute(
    case: Case,
    name: str,
    *,
    build: Build | None = None,
    deck: Deck | None = None,
    limit_s: float | None = None,
    folder: Path | None = None,
    own_process: bool = False,
) -> Computed:
    """Compute a case on an engine; a run that fails is a result with the reason.

    Args:
        case: the case.
        name: name of the engine.
        build: build of the engine, if known.
        deck: deck of the case, if rendered already.
        limit_s: time limit in s; None for ``default_limit_s``.
        folder: folder that receives the deck, the output of the code, and its standard output and error.
        own_process: True for a process of its own also without a folder, and for an in-repo engine.

    Raises:
        InputError: temporary files lie where other users could replace them.
        RunError: the engine is not installed.
        OSError: the run failed on a full disk.
    """
    engine = load_engine(name)
    limit_s = limit_s or engine.entry.time_limit or default_limit_s(case)
    if engine.integrate is not None and not own_process:
        if folder is not None:
            engine.by_hand(deck or engine.render(case)).write(folder)
        return _in_memory(case, engine, limit_s, folder)
    build, deck = build or build_of(engine), deck or engine.render(case)
    if folder or own_process or not _serves_alike(name, build):
        ended = _own_process(case, engine, build, deck, limit_s, folder)
    else:
        ended = _served(case, engine, build, deck, limit_s)
    for place in (folder or gettempdir(), gettempdir()) if ended.fault else ():
        _check_room(Path(place))
    return ended


def _check_room(folder: Path) -> None:
    """Raise OSError if the disk is full, which is not a failure of the case."""
    try:
        with TemporaryFile(dir=folder) as probe:
            os.posix_fallocate(probe.fileno(), 0, PROBE_BYTES)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from error


def _in_memory(case: Case, engine: Engine, limit_s: float, folder: Path | None) -> Computed:
    """Integrate a case in this process."""
    began, loop_s, cpu_s, trace, fault = time.perf_counter(), None, 0.0, None, None

    def integrate(stop: Flag) -> tuple[Trace, float, float]:
        assert engine.integrate is not None
        with np.errstate(all="ignore"):  # runs that blow up are reported by the guard
            return *engine.integrate(case, stop), time.thread_time()  # of a thread of its own

    try:
        integrated, loop_s, cpu_s = endable(integrate, limit_s)
        trace = checked(case, integrated)
    except RunError as error:
        fault = error
    except TimeoutError:
        fault = timed_out(limit_s)
    except Exception as error:  # of the integrator fails the run, as an error of a code does
        fault = RunError(f"{type(error).__name__}: {error}")
    if folder is not None:
        said = "" if loop_s is None else f"completed {case.scene.samples} samples in {loop_s:.6f} s\n"
        (folder / STDOUT).write_text(said)
        (folder / STDERR).write_text(f"{fault}\n" if fault and loop_s is None else "")
    memory_bytes = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return Computed(trace, fault, time.perf_counter() - began, cpu_s, memory_bytes, loop_s)


def _own_process(
    case: Case, engine: Engine, build: Build, deck: Deck, limit_s: float, folder: Path | None = None
) -> Computed:
    """Run a deck in a process of its own."""
    with nullcontext(folder) if folder else workplace(private_temporary_folder()) as place:
        engine.by_hand(deck).write(place)
        outcome = run_command(engine.started(deck, build.command), place, limit_s, **engine.environment)
        return _ended(case, engine, outcome, place)


def _served(case: Case, engine: Engine, build: Build, deck: Deck, limit_s: float) -> Computed:
    """Run a deck on a server, a second time in a new process if it ended one that had served other cases."""
    with lent(engine, build) as session:
        before_s = session.start_s
        outcome = session.run(deck, limit_s)
        if session.ended and session.served > 1 and not outcome.timed_out:
            outcome = session.run(deck, limit_s)
        return _ended(case, engine, outcome, session.case, session.start_s - before_s)


def _ended(case: Case, engine: Engine, outcome: EndedProcess, folder: Path, start_s: float = 0.0) -> Computed:
    """Read and check the output of a process in its folder."""
    trace, fault = None, None
    try:
        trace = checked_trace(case, engine, outcome, folder)
    except RunError as error:
        fault = error
    loop_s = engine.loop_seconds((folder / STDOUT).read_text(errors="replace"))
    return Computed(trace, fault, outcome.wall_s, outcome.cpu_s, outcome.memory_bytes, loop_s, start_s)


@cache
def _serves_alike(name: str, build: Build) -> bool:
    """True if a build as a server gives the same bits as in a process of its own, tested by a short run.

    If a run fails, which another process may have caused, the result is that of this process alone.
    """
    key = ["serves alike", name, build.identity]
    with _server_test:
        alike = load(key)
        if alike is None:
            case, engine = build_case(read_scene(*PROBE)), load_engine(name)
            given = (case, engine, build, engine.render(case), default_limit_s(case))
            alone, served = _own_process(*given).trace, _served(*given).trace
            if alone is None or served is None:
                return False
            alike = store(key, digest_of(alone) == digest_of(served))
        return bool(alike)
