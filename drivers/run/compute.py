"""A case on an engine: the only way in which a case becomes a trace.

An in-repo engine integrates in this process. The deck of a code runs in a process of its own if it has a folder of its
own, unless a server is asked for; else on a server process that runs one deck after another, since start-up dominates
the cost of small cases. A case that ends the server runs again in a process of its own, and so does one of a build that
is no server, as behind a script that passes no input on.
"""

import atexit
import os
import resource
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from multiprocessing import connection
from pathlib import Path
from tempfile import TemporaryFile, gettempdir

import numpy as np

from drivers.base.decks import Deck
from drivers.base.errors import RunError
from drivers.base.processes import STDERR, STDOUT, EndedProcess, Launched, end, run_command, start, waited, workplace
from drivers.chain.case import Case
from drivers.chain.chain import arrays_of
from drivers.chain.schemes import default_limit_s, endable, work_of_exact
from drivers.chain.trace import Trace
from drivers.engines import EXACT, Engine, load_engine
from drivers.run.build import Build, build_of
from drivers.run.scheme import checked, checked_trace, timed_out
from validation.reference.hertz_chain import Flag

DONE = "the-case-has-ended"  # printed by the server after a deck
START_LIMIT_S = 60.0
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
        work = work_of_exact(arrays_of(case.chain), case.duration_s) if engine.scheme == EXACT else case.work
        integrated, loop_s, cpu_s = endable(integrate, limit_s, work)
        trace = checked(case, integrated)
    except RunError as error:
        fault = error
    except TimeoutError:
        fault = RunError(timed_out(limit_s), "timeout")
    except Exception as error:  # of the integrator fails the run, as an error of a code does
        fault = RunError(f"{type(error).__name__}: {error}")
    memory_bytes = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return Computed(trace, fault, time.perf_counter() - began, cpu_s, memory_bytes, loop_s)


def _own_process(case: Case, engine: Engine, build: Build, deck: Deck, limit_s: float, folder: Path | None) -> Computed:
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


class Session:
    """Server process of one engine, started by the first case, and again after a case that ended it.

    Attributes:
        case: folder in which decks run.
        start_s: waiting time for the start of the process before the last case; else 0.
        answers: False after a start without an answer; there is no other start then.
    """

    def __init__(self, engine: Engine, build: tuple[str, ...], folder: Path) -> None:
        self.engine = engine
        self.build = build
        self.folder = folder
        self.case = folder / "case"
        self.start_s = 0.0
        self.answers = True
        self._launched: Launched | None = None

    def run(self, deck: Deck, limit_s: float) -> EndedProcess:
        """Run a deck in the folder ``case``; its output stays there until the next run.

        Raises:
            RunError: no server answers.
            OSError: no process can be started.
            KeyboardInterrupt: all work is being stopped.
        """
        self.start_s = self._start() if self.ended and self.answers else 0.0
        self.answers = not self.ended
        if self.ended:
            raise RunError("the server does not answer")
        # removed first: some file systems, such as ext4, wait for the disk when a file is overwritten
        for name in (*deck.raw, *deck.files, STDOUT):
            (self.case / name).unlink(missing_ok=True)
        deck.write(self.case)
        os.truncate(self.case / STDERR, 0)
        return self._ask(self.case.name, limit_s)

    def _start(self) -> float:
        """Start the server; returns the time in s until it answers, or does not."""
        shutil.rmtree(self.case, ignore_errors=True)  # remove files of a failed case
        self.case.mkdir(parents=True)
        self.engine.server.write(self.folder)
        command, pipe = self.engine.started(self.engine.server, self.build), subprocess.PIPE
        with open(self.case / STDERR, "ab") as stderr:  # emptied before each case
            # own temporary files: two MPI programs that make their common folder at the same time may fail
            variables = {"TMPDIR": str(self.folder)} | self.engine.environment
            self._launched = start(command, self.folder, variables, stdin=pipe, stdout=pipe, stderr=stderr)
        return self._ask("", START_LIMIT_S).wall_s

    @property
    def ended(self) -> bool:
        """True if there is no process: not yet started, or ended by the last case."""
        return self._launched is None

    def close(self) -> int:
        """End the process if there is one; return its exit code."""
        launched, self._launched = self._launched, None
        return end(*launched)[0] if launched else 0

    def _ask(self, name: str, limit_s: float) -> EndedProcess:
        """Send a request and wait for ``DONE``, the end of the process, or the time limit."""
        assert self._launched is not None
        stdin, stdout = self._launched[0].stdin, self._launched[0].stdout
        assert stdin is not None
        assert stdout is not None
        began, word, output, part = time.perf_counter(), f"{DONE}\n".encode(), bytearray(), b" "
        with suppress(OSError):  # the process has died: its output is read below
            stdin.write(self.engine.request(name, DONE).encode())
            stdin.flush()
        in_time = True
        while in_time and part and not output.endswith(word):
            in_time = waited(lambda seconds: connection.wait([stdout.fileno()], seconds), began + limit_s)
            part = os.read(stdout.fileno(), 1 << 16) if in_time else b""
            output += part
        wall_s = time.perf_counter() - began
        code = 0 if output.endswith(word) else self.close()
        (self.case / STDOUT).write_bytes(output.removesuffix(word))
        return EndedProcess(code, not in_time, limit_s, wall_s)


_idle: dict[tuple[object, ...], list[Session]] = {}  # by build; all end with this process


@contextmanager
def lent(engine: Engine, build: Build) -> Iterator[Session]:
    """Lend a session of a build to one thread: an idle one, or a new one in a folder of its own."""
    sessions = _idle.setdefault((engine.server.sha256, build, *sorted(engine.environment.items())), [])
    try:
        session = sessions.pop()
    except IndexError:
        place = ExitStack()
        atexit.register(place.close)
        session = Session(engine, build.command, place.enter_context(workplace()))
        place.callback(session.close)
    try:
        yield session
    except BaseException:
        session.close()  # its state is unknown; the next request starts a new process
        raise
    finally:
        sessions.append(session)
