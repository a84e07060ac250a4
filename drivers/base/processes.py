"""Runs an engine as a process of its own, in a scrubbed environment and within a time limit."""

import os
import re
import resource
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO

KEPT_VARIABLES = ("PATH", "HOME", "USER", "LOGNAME", "TMPDIR", "LD_LIBRARY_PATH")
PROBE_LIMIT_S = 20.0
UNKNOWN_VERSION = "unknown"
COULD_NOT_START = 127  # as a shell says it

Stream = IO[bytes] | int

_lock = threading.Lock()
_running: set[int] = set()  # leaders of the process groups under way
_stops = 0  # how many ask that nothing runs


@dataclass(frozen=True)
class Outcome:
    """How a process ended.

    Attributes:
        code: exit code; negative for a signal.
        timed_out: it was killed at the time limit, ``limit_s``.
        wall_s, cpu_s: of the whole process with its children.
        memory_bytes: the most it held.
    """

    code: int
    timed_out: bool
    limit_s: float
    wall_s: float
    cpu_s: float
    memory_bytes: int


def scrubbed_environment() -> dict[str, str]:
    """Nothing of a virtual environment reaches an engine: YADE would pick up foreign modules."""
    kept = {name: os.environ[name] for name in KEPT_VARIABLES if name in os.environ}
    return kept | {"LC_ALL": "C.UTF-8", "PYTHONNOUSERSITE": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}


def run_command(command: tuple[str, ...], folder: Path, limit_s: float, **variables: str) -> Outcome:
    """Runs a command inside ``folder``; its output goes to ``stdout.txt`` and ``stderr.txt`` there.

    ``variables`` are added to the environment. The process leads a group of its own, which is killed at the time
    limit; where the system can, it is also killed when this one dies.
    """
    began = time.perf_counter()
    with open(folder / "stdout.txt", "wb") as out, open(folder / "stderr.txt", "wb") as err:
        try:
            process = start(command, folder, subprocess.DEVNULL, out, err, **variables)
        except OSError as error:
            err.write(f"cannot start: {error}\n".encode())
            return Outcome(COULD_NOT_START, False, limit_s, wall_s=0.0, cpu_s=0.0, memory_bytes=0)
        expired = threading.Event()

        def expire() -> None:
            expired.set()
            kill_group(process.pid)

        timer = threading.Timer(min(limit_s, threading.TIMEOUT_MAX), expire)
        timer.start()
        try:
            os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # its id stays its own until it is reaped below
        finally:
            timer.cancel()
            usage = reap(process)  # or stop it, if this was interrupted
    return Outcome(
        code=process.returncode,
        timed_out=expired.is_set(),
        limit_s=limit_s,
        wall_s=time.perf_counter() - began,
        cpu_s=usage.ru_utime + usage.ru_stime,
        memory_bytes=usage.ru_maxrss * 1024,
    )


def start(
    command: tuple[str, ...], folder: Path, stdin: Stream, stdout: Stream, stderr: Stream, **variables: str
) -> subprocess.Popen[bytes]:
    """Starts a process that leads a group of its own and, where the system can, dies with this one.

    Raises:
        OSError: it cannot be started.
    """
    guard = ("setpriv", "--pdeathsig", "KILL") if shutil.which("setpriv") else ()
    process = subprocess.Popen(
        (*guard, *command),
        cwd=folder,
        env=scrubbed_environment() | variables,
        stdin=stdin,
        stdout=stdout,
        stderr=stderr,
        start_new_session=True,
    )
    with _lock:
        _running.add(process.pid)
        stopped = _stops > 0
    if stopped:
        kill_group(process.pid)
    return process


def reap(process: subprocess.Popen[bytes]) -> resource.struct_rusage:
    """Kills what is left of a process and of its group; what it used.

    Raises:
        KeyboardInterrupt: everything is being stopped.
    """
    with _lock:
        _running.discard(process.pid)
        stopped = _stops > 0
    kill_group(process.pid)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if stopped:
        raise KeyboardInterrupt
    return usage


def cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def all_stopped() -> Iterator[None]:
    """Kills all that other threads run, and all they start meanwhile: it ends there as if by Ctrl-C."""
    global _stops
    with _lock:
        _stops += 1
        for leader in _running:
            kill_group(leader)
    try:
        yield
    finally:
        with _lock:
            _stops -= 1


def find_program(name: str) -> Path | None:
    """Path of a program on PATH; None where it is not there."""
    path = shutil.which(name)
    return Path(path) if path else None


def version_in_words(executable: Path, option: str, pattern: str) -> str:
    """Version of a program: the first group of ``pattern`` in the first line that it prints with ``option``."""
    with tempfile.TemporaryDirectory() as folder:  # LIGGGHTS leaves a log wherever it is asked
        run_command((str(executable), option), Path(folder), PROBE_LIMIT_S)
        lines = (Path(folder) / "stdout.txt").read_text(errors="replace").strip().splitlines()
    match = re.search(pattern, lines[0]) if lines else None
    return match.group(1) if match else UNKNOWN_VERSION


def kill_group(leader: int) -> None:
    """Kills a process with all it started."""
    try:
        os.killpg(leader, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        pass
