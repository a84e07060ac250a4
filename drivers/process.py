"""Runs an engine as a process of its own, in a scrubbed environment and within a time limit."""

import os
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

KEPT = ("PATH", "HOME", "USER", "LOGNAME", "TMPDIR", "LD_LIBRARY_PATH")
PROBE_LIMIT_S = 20.0
UNKNOWN_VERSION = "unknown"
COULD_NOT_START = 127  # as a shell says it


_running: set[int] = set()  # leaders of the process groups under way
_stopped = threading.Event()


@dataclass(frozen=True)
class Outcome:
    """How a process ended.

    Attributes:
        code: exit code; negative for a signal.
        timed_out: it was killed at the time limit.
        wall_s, cpu_s: of the whole process with its children.
        memory_bytes: the most it held.
    """

    code: int
    timed_out: bool
    wall_s: float
    cpu_s: float
    memory_bytes: int


def scrubbed_environment() -> dict[str, str]:
    """Nothing of a virtual environment reaches an engine: YADE would pick up foreign modules."""
    kept = {name: os.environ[name] for name in KEPT if name in os.environ}
    return kept | {"LC_ALL": "C.UTF-8", "PYTHONNOUSERSITE": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}


def run_command(command: tuple[str, ...], folder: Path, limit_s: float, **variables: str) -> Outcome:
    """Runs a command inside ``folder``; its output goes to ``stdout.txt`` and ``stderr.txt`` there.

    ``variables`` are added to the environment. The process leads a group of its own, which is killed at the time
    limit; where the system can, it is also killed when this one dies.
    """
    guard = ("setpriv", "--pdeathsig", "KILL") if shutil.which("setpriv") else ()
    began = time.perf_counter()
    with open(folder / "stdout.txt", "wb") as out, open(folder / "stderr.txt", "wb") as err:
        try:
            process = subprocess.Popen(
                (*guard, *command),
                cwd=folder,
                env=scrubbed_environment() | variables,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                start_new_session=True,
            )
        except OSError as error:
            err.write(f"cannot start: {error}\n".encode())
            return Outcome(COULD_NOT_START, timed_out=False, wall_s=0.0, cpu_s=0.0, memory_bytes=0)
        _running.add(process.pid)
        if _stopped.is_set():
            _kill_group(process.pid)
        expired = threading.Event()

        def expire() -> None:
            expired.set()
            _kill_group(process.pid)

        timer = threading.Timer(min(limit_s, threading.TIMEOUT_MAX), expire)
        timer.start()
        try:
            _, status, usage = os.wait4(process.pid, 0)
            process.returncode = os.waitstatus_to_exitcode(status)
        except BaseException:
            _kill_group(process.pid)
            raise
        finally:
            timer.cancel()
            _running.discard(process.pid)
    _kill_group(process.pid)  # what it may have left behind
    if _stopped.is_set():
        raise KeyboardInterrupt
    return Outcome(
        code=process.returncode,
        timed_out=expired.is_set(),
        wall_s=time.perf_counter() - began,
        cpu_s=usage.ru_utime + usage.ru_stime,
        memory_bytes=usage.ru_maxrss * 1024,
    )


def stop_all() -> None:
    """Kills all that runs in other threads, for good: what they wait for ends as if by Ctrl-C."""
    _stopped.set()
    for leader in tuple(_running):
        _kill_group(leader)


def first_line_of(command: tuple[str, ...]) -> str:
    """The first line that a command prints; empty where it prints none in time or cannot start."""
    with tempfile.TemporaryDirectory() as folder:  # LIGGGHTS leaves a log wherever it is asked
        run_command(command, Path(folder), PROBE_LIMIT_S)
        lines = (Path(folder) / "stdout.txt").read_text(errors="replace").strip().splitlines()
    return lines[0].strip() if lines else ""


def _kill_group(leader: int) -> None:
    try:
        os.killpg(leader, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        pass
