"""Engine processes that run one deck after another, since start-up dominates the cost of small cases."""

import atexit
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing import connection
from pathlib import Path

from drivers.base.decks import Deck
from drivers.base.errors import RunError
from drivers.base.processes import STDERR, STDOUT, EndedProcess, Launched, end, start, waited, workplace
from drivers.engines import Engine
from drivers.run.build import Build

DONE = "the-case-has-ended"  # printed by the server after a deck
START_LIMIT_S = 60.0


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
        if self._launched is None:
            return 0
        launched, self._launched = self._launched, None
        return end(*launched)[0]

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
