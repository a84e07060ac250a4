"""Engine processes that run one deck after another, since start-up dominates the cost of small cases."""

import os
import selectors
import shutil
import subprocess
import threading
import time
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing.util import Finalize
from pathlib import Path
from tempfile import gettempdir, mkdtemp

from drivers.base.decks import Deck
from drivers.base.processes import COULD_NOT_START, STDERR, STDOUT, EndedProcess, reap, reset_peak, start, used_by
from drivers.engines import Engine
from drivers.run.build import Build
from drivers.run.workplaces import workplace

DONE = "the-case-has-ended"  # printed by the server after a deck
MAX_START_S, MIN_START_S = 60.0, 10.0  # bounds of the time limit of a start, which is else the case's
EXIT_LIMIT_S = 5.0
MAX_WAIT_S = 3600.0  # longest single wait; select() overflows after some weeks
OUTPUT_BYTES = 1 << 20  # last part of the output, which is kept


_starter = ThreadPoolExecutor(1)  # processes die with the thread that starts them; this thread lasts


class Session:
    """Server process of one engine, started by the first case, and again after a case that killed it.

    Attributes:
        case: folder in which decks run.
        start_s: total waiting time for starts.
        served: number of cases of the present or last process.
    """

    def __init__(self, engine: Engine, build: tuple[str, ...], folder: Path) -> None:
        self.engine = engine
        self.build = build
        self.folder = folder
        self.case = folder / "case"
        self.start_s = 0.0
        self.served = 0
        self._process: subprocess.Popen[bytes] | None = None

    def run(self, deck: Deck, limit_s: float, *, measured: bool = False) -> EndedProcess:
        """Run a deck in the folder ``case``; its output stays there until the next run.

        A case that ends the process has the same outcome as in its own process; the next case gets a new process.
        ``measured`` includes CPU time and memory of the case in the outcome, which takes half a millisecond.
        """
        if self._process is None or not self.served:
            shutil.rmtree(self.case, ignore_errors=True)  # remove files of a failed case
            self.case.mkdir(parents=True)
        # removed first: some file systems, such as ext4, wait for the disk when a file is overwritten
        for name in (*deck.raw, *deck.files, STDOUT, STDERR):
            (self.case / name).unlink(missing_ok=True)
        deck.write(self.case)
        began = time.perf_counter()
        try:
            self.start()
        except OSError as error:
            (self.case / STDOUT).write_text("")
            (self.case / STDERR).write_text(f"cannot start: {error}\n")
            return EndedProcess(COULD_NOT_START, False, limit_s)
        if self.served == 0:
            outcome = self._ask("", min(MAX_START_S, max(limit_s, MIN_START_S)), measured=False)
            self.start_s += time.perf_counter() - began
            if self.ended:
                return outcome
        self.served += 1
        return self._ask(self.case.name, limit_s, measured=measured)

    def start(self) -> None:
        """Start the server if there is none, without waiting for it; OSError if it cannot be started."""
        if self._process is not None:
            return
        self.engine.server.write(self.folder)
        self.served = 0
        command, pipe = self.engine.started(self.engine.server, self.build), subprocess.PIPE
        with open(self.folder / STDERR, "wb") as stderr:
            # own temporary files: two MPI programs that make their common folder at the same time may fail
            variables = {"TMPDIR": str(self.folder)} | self.engine.environment
            starting = _starter.submit(start, command, self.folder, pipe, pipe, stderr, variables)
            self._process = starting.result()

    @property
    def ended(self) -> bool:
        """True if there is no process: not yet started, or ended by the last case."""
        return self._process is None

    def close(self) -> int:
        """End the process if there is one; return its exit code."""
        process, self._process = self._process, None
        if process is None:
            return 0
        for stream in (process.stdin, process.stdout):
            with suppress(OSError):  # unsent input is not needed any more
                if stream is not None:
                    stream.close()
        reap(process)
        return process.returncode

    def _ask(self, name: str, limit_s: float, *, measured: bool) -> EndedProcess:
        """Send a request and wait for ``DONE``, the end of the process, or the time limit."""
        process = self._process
        assert process is not None
        assert process.stdin is not None
        before_s, before_bytes = 0.0, (self.folder / STDERR).stat().st_size
        if measured:
            reset_peak(process.pid)
            before_s, _ = used_by(process.pid)
        began = time.perf_counter()
        with suppress(OSError):  # the process has died: its output is read below
            process.stdin.write(self.engine.request(name, DONE).encode())
            process.stdin.flush()
        output, state = _listen(process, began + limit_s)
        wall_s = time.perf_counter() - began
        (self.case / STDOUT).write_bytes(output)
        if state == "ended":
            _await_end(process)
        (self.case / STDERR).write_bytes((self.folder / STDERR).read_bytes()[before_bytes:])
        if state == "done":
            after_s, memory_bytes = used_by(process.pid) if measured else (0.0, 0)
            return EndedProcess(0, False, limit_s, wall_s, after_s - before_s, memory_bytes)
        return EndedProcess(self.close(), state == "late", limit_s, wall_s)


_idle: dict[tuple[object, ...], list[Session]] = defaultdict(list)  # by build; all end with this process
_places = ExitStack()  # holds the workplace of the sessions
_homes: list[Path] = []  # the workplace, once there is one
_lending = threading.Lock()


@contextmanager
def lent(engine: Engine, build: Build) -> Iterator[Session]:
    """Lend a session of a build to one thread: an idle one, or a new one."""
    key = (engine.server.sha256, build, *sorted(engine.environment.items()))
    with _lending:
        session = _idle[key].pop() if _idle[key] else None
    session = session or Session(engine, build.command, _new_folder())
    try:
        yield session
    except BaseException:
        session.close()  # its state is unknown; the next request starts a new process
        raise
    finally:
        with _lending:
            _idle[key].append(session)


def _new_folder() -> Path:
    """Folder of a session, in this process' workplace; the next command removes that of a killed process."""
    with _lending:
        if not _homes:
            Finalize(None, end_all, exitpriority=10)  # also at the end of a worker of multiprocessing
            _homes.append(_places.enter_context(workplace(Path(gettempdir(), f"bead-chains-{os.getuid()}"))))
        return Path(mkdtemp(dir=_homes[0]))


def end_all() -> None:
    """End all idle sessions."""
    with _lending:
        for session in (session for sessions in _idle.values() for session in sessions):
            session.close()
        _idle.clear()
        home = _homes.pop().parent if _homes else None
        _places.close()
        if home:
            with suppress(OSError):  # not empty: other processes work there
                home.rmdir()


def _await_end(process: subprocess.Popen[bytes]) -> None:
    """Wait for a process that has closed its output, to get its own exit code."""
    until = time.perf_counter() + EXIT_LIMIT_S
    while time.perf_counter() < until:
        if os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT | os.WNOHANG) is not None:
            return
        time.sleep(0.005)


def _listen(process: subprocess.Popen[bytes], until: float) -> tuple[bytes, str]:
    """Output of the process before the word ``DONE``, and its state: ``done``, ``ended`` or ``late``."""
    assert process.stdout is not None
    word = f"{DONE}\n".encode()
    output = b""
    with selectors.DefaultSelector() as selector:
        selector.register(process.stdout, selectors.EVENT_READ)
        while not output.endswith(word):
            if selector.select(min(max(until - time.perf_counter(), 0.0), MAX_WAIT_S)):
                part = os.read(process.stdout.fileno(), 1 << 16)
                if not part:
                    return output, "ended"
                output = (output + part)[-OUTPUT_BYTES:]
            if time.perf_counter() > until and not output.endswith(word):
                return output, "late"
    return output.removesuffix(word), "done"
