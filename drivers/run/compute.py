"""A case on an engine: the only way in which a case becomes a trace.

An in-repo engine integrates in this process. The deck of a code runs in a process of its own if it has a folder of its
own, unless a server is asked for; else on a server process that runs one deck after another, since start-up dominates
the cost of small cases. A case that ends the server runs again in a process of its own, and so does one of a build that
is no server, as behind a script that passes no input on.
"""

import os
import resource
import shutil
import time
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path
from tempfile import TemporaryFile, gettempdir

import numpy as np

from drivers.base.decks import Deck
from drivers.base.errors import RunError
from drivers.base.processes import STDERR, STDOUT, EndedProcess, run_command, workplace
from drivers.chain.case import Case
from drivers.chain.schemes import default_limit_s, endable
from drivers.chain.trace import Trace
from drivers.engines import EXACT, Engine, load_engine
from drivers.run.build import Build, build_of
from drivers.run.guard import checked, checked_trace, timed_out
from drivers.run.session import lent
from validation.reference.hertz_chain import Flag

PROBE_BYTES = 1 << 24  # room without which a disk counts as full: Open MPI frees 8 MB as soon as a code has ended


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
    own_process: bool | None = None,
) -> Computed:
    """Compute a case on an engine; a run that fails is a result with the reason.

    Args:
        case: the case.
        name: name of the engine.
        build: build of the engine, if known.
        deck: deck of the case, if rendered already.
        limit_s: time limit in s; None for ``default_limit_s``.
        folder: folder that receives the deck, the output of the code, and its standard output and error.
        own_process: True for a process of its own, also for an in-repo engine; False for a server; None for a process
            of its own if there is a folder.

    Raises:
        InputError: temporary files lie where other users could replace them.
        RunError: the engine is not installed.
        OSError: the run failed on a full disk.
    """
    engine = load_engine(name)
    limit_s = limit_s or engine.entry.time_limit or default_limit_s(case)
    if engine.integrate is not None and not own_process:
        ended = _in_memory(case, engine, limit_s)
        if folder is not None:
            engine.by_hand(deck or engine.render(case)).write(folder)
            said = "" if ended.loop_s is None else f"completed {case.scene.samples} samples in {ended.loop_s:.6f} s\n"
            (folder / STDOUT).write_text(said)
            (folder / STDERR).write_text("" if said else f"{ended.fault}\n")
        return ended
    build, deck = build or build_of(engine), deck or engine.render(case)
    alone = folder is not None if own_process is None else own_process
    served = None if alone else _served(case, engine, build, deck, limit_s, folder)
    ended = served or _own_process(case, engine, build, deck, limit_s, folder)
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


def _in_memory(case: Case, engine: Engine, limit_s: float) -> Computed:
    """Integrate a case in this process."""
    began, loop_s, cpu_s, trace, fault = time.perf_counter(), None, 0.0, None, None

    def integrate(stop: Flag) -> tuple[Trace, float, float]:
        assert engine.integrate is not None
        began_cpu_s = time.thread_time()
        with np.errstate(all="ignore"):  # runs that blow up are reported by the guard
            return *engine.integrate(case, stop), time.thread_time() - began_cpu_s

    try:
        # bodies times steps do not bound the work of an exact motion
        integrated, loop_s, cpu_s = endable(integrate, limit_s, inf if engine.scheme == EXACT else case.work)
        trace = checked(case, integrated)
    except RunError as error:
        fault = error
    except TimeoutError:
        fault = RunError(timed_out(limit_s), "timeout")
    except Exception as error:  # of the integrator fails the run, as an error of a code does
        fault = RunError(f"{type(error).__name__}: {error}")
    memory_bytes = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return Computed(trace, fault, time.perf_counter() - began, cpu_s, memory_bytes, loop_s)


def _own_process(
    case: Case, engine: Engine, build: Build, deck: Deck, limit_s: float, folder: Path | None = None
) -> Computed:
    """Run a deck in a process of its own."""
    with nullcontext(folder) if folder else workplace() as place:
        engine.by_hand(deck).write(place)
        outcome = run_command(engine.started(deck, build.command), place, limit_s, **engine.environment)
        return _ended(case, engine, outcome, place)


def _served(
    case: Case, engine: Engine, build: Build, deck: Deck, limit_s: float, folder: Path | None
) -> Computed | None:
    """Run a deck on a server; None if that does not answer, or ended before the time limit."""
    with lent(engine, build) as session, suppress(RunError):
        outcome = session.run(deck, limit_s)
        if outcome.timed_out or not session.ended:
            if folder:
                engine.by_hand(deck).write(folder)
                for name in (STDOUT, STDERR):
                    shutil.copyfile(session.case / name, folder / name)
            return _ended(case, engine, outcome, session.case, session.start_s)
    return None


def _ended(case: Case, engine: Engine, outcome: EndedProcess, folder: Path, start_s: float = 0.0) -> Computed:
    """Read and check the output of a process in its folder."""
    trace, fault = None, None
    try:
        trace = checked_trace(case, engine, outcome, folder)
    except RunError as error:
        fault = error
    loop_s = engine.loop_seconds((folder / STDOUT).read_text(errors="replace"))
    return Computed(trace, fault, outcome.wall_s, outcome.cpu_s, outcome.memory_bytes, loop_s, start_s)
