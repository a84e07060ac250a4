"""Engine processes: a minimal environment, a time limit, no orphans."""

import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import psutil

from drivers.base import paths
from drivers.base.files import home_of

KEPT_VARIABLES = ("PATH", "HOME", "USER", "LOGNAME", "TMPDIR", "LD_LIBRARY_PATH")
PROBE_LIMIT_S = 20.0
UNKNOWN_VERSION = "unknown"
COULD_NOT_START = 127  # as in a shell
STDOUT, STDERR = "stdout.txt", "stderr.txt"  # output of a process, in its folder

Stream = IO[bytes] | int

_lock = threading.Lock()
_running: dict[object, Callable[[], None]] = {}  # work under way, with the function that ends it
_stops = 0  # number of active all_stopped()


# Runs a command. At SIGTERM, which the system sends when this process dies, it kills the command's session: otherwise
# only a script would die, not the code that it starts. It writes the command's peak memory into a pipe: started
# directly, the peak would include the memory that this large Python process holds at the fork.
LAUNCHER = """
import os, signal, sys
def end(*_):
    for name in filter(str.isdigit, os.listdir("/proc")):
        try:
            if int(name) != os.getpid() and os.getsid(int(name)) == os.getsid(0):
                os.kill(int(name), signal.SIGKILL)
        except OSError:
            pass
    os._exit(1)
signal.signal(signal.SIGTERM, end)
parent, pipe, command = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]
if os.getppid() != parent:  # it died before the system was asked for the signal
    sys.exit(1)
if pipe >= 0:
    os.set_inheritable(pipe, False)  # children that outlive the command must not hold the pipe open
try:
    child = os.posix_spawnp(command[0], command, os.environ, setsigdef=[signal.SIGPIPE, signal.SIGXFSZ])
except OSError as error:
    sys.exit(f"cannot start: {error}")
null = os.open(os.devnull, os.O_RDWR)
for stream in (0, 1, 2):  # so that the command alone holds its output open
    os.dup2(null, stream)
_, status, usage = os.wait4(child, 0)
if pipe >= 0:
    os.write(pipe, str(usage.ru_maxrss * 1024).encode())
code = os.waitstatus_to_exitcode(status)
if code < 0:
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.kill(os.getpid(), -code)
os._exit(code)
"""


@dataclass(frozen=True)
class EndedProcess:
    """End of a process.

    Attributes:
        code: exit code; negative for a signal.
        timed_out: True if it was killed at the time limit.
        limit_s: time limit.
        wall_s, cpu_s: wall and CPU time of the process with its children.
        memory_bytes: peak memory; 0 if the process was killed from here.
    """

    code: int
    timed_out: bool
    limit_s: float
    wall_s: float = 0.0
    cpu_s: float = 0.0
    memory_bytes: int = 0


def scrubbed_environment() -> dict[str, str]:
    """Environment of engines, without the virtual environment: YADE would import its modules."""
    kept = {"HOME": str(home_of("~"))} | {name: os.environ[name] for name in KEPT_VARIABLES if name in os.environ}
    return kept | {"LC_ALL": "C.UTF-8", "PYTHONNOUSERSITE": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}


def run_command(command: tuple[str, ...], folder: Path, limit_s: float, **variables: str) -> EndedProcess:
    """Run a command inside ``folder``; its output goes to ``STDOUT`` and ``STDERR`` there.

    ``variables`` are added to the environment. The process is killed at the time limit, with all that it has started.
    """
    began, (read_end, pipe) = time.perf_counter(), os.pipe()
    with open(folder / STDOUT, "wb") as out, open(folder / STDERR, "wb") as err, open(read_end, "rb") as memory:
        try:
            with open(pipe, "wb"):
                process = start(command, folder, subprocess.DEVNULL, out, err, variables, pipe)
        except OSError as error:
            err.write(f"cannot start: {error}\n".encode())
            return EndedProcess(COULD_NOT_START, False, limit_s)
        expired = threading.Event()

        def expire() -> None:
            expired.set()
            kill_group(process.pid)

        timer = threading.Timer(min(limit_s, threading.TIMEOUT_MAX), expire)
        timer.start()
        try:
            os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # the id stays reserved until reaped below
        finally:
            timer.cancel()
            usage = reap(process)  # also kills it after an interruption
        memory_bytes = int(memory.read() or 0)
    return EndedProcess(
        code=process.returncode,
        timed_out=expired.is_set(),
        limit_s=limit_s,
        wall_s=time.perf_counter() - began,
        cpu_s=usage.ru_utime + usage.ru_stime,
        memory_bytes=memory_bytes,
    )


def _at_death_of_parent(signal_name: str) -> tuple[str, ...]:
    """Prefix of a command to which the system sends a signal when its parent dies; empty without ``setpriv``."""
    return ("setpriv", "--pdeathsig", signal_name) if shutil.which("setpriv") else ()


def start(
    command: tuple[str, ...],
    folder: Path,
    stdin: Stream,
    stdout: Stream,
    stderr: Stream,
    variables: dict[str, str],
    pipe: int = -1,
) -> subprocess.Popen[bytes]:
    """Start a command in a session of its own, which dies with this process where ``setpriv`` is available.

    ``pipe`` receives the peak memory in bytes; -1 for none.

    Raises:
        OSError: the process cannot be started.
    """
    launcher = (sys.executable, "-I", "-S", "-c", LAUNCHER, str(os.getpid()), str(pipe))
    process = subprocess.Popen(
        (*_at_death_of_parent("TERM"), *launcher, *_at_death_of_parent("KILL"), *command),
        cwd=folder,
        env=scrubbed_environment() | variables,
        stdin=stdin,
        stdout=stdout,
        stderr=stderr,
        pass_fds=(pipe,) if pipe >= 0 else (),
        start_new_session=True,
    )
    _register(process.pid, lambda: kill_group(process.pid))
    return process


def reap(process: subprocess.Popen[bytes]) -> resource.struct_rusage:
    """Kill the rest of a process and its group; return the resources it used.

    Raises:
        KeyboardInterrupt: all processes are being stopped.
    """
    stopped = _unregister(process.pid)
    kill_group(process.pid)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if stopped:
        raise KeyboardInterrupt
    return usage


@contextmanager
def stoppable(stop: Callable[[], None]) -> Iterator[None]:
    """Context for work of this process, which ``all_stopped`` ends by calling ``stop``.

    Raises:
        KeyboardInterrupt: all work is being stopped.
    """
    work = object()
    _register(work, stop)
    try:
        yield
    finally:
        if _unregister(work):
            raise KeyboardInterrupt


def _register(work: object, stop: Callable[[], None]) -> None:
    with _lock:
        _running[work] = stop
        stopped = _stops > 0
    if stopped:
        stop()


def _unregister(work: object) -> bool:
    """Forget a piece of work; True if all work is being stopped."""
    with _lock:
        _running.pop(work, None)
        return _stops > 0


def used_by(leader: int) -> tuple[float, int]:
    """CPU seconds of a process with its children, and the largest peak memory of one of them in bytes.

    Zeros without ``/proc``. psutil counts CPU time in hundredths of a second and knows no peak.
    """
    cpu_s, memory_bytes = 0.0, 0
    with suppress(OSError, IndexError, ValueError):
        for process in _family(leader):
            for thread in Path(f"/proc/{process}/task").iterdir():
                cpu_s += int((thread / "schedstat").read_text().split()[0]) * 1e-9
            peak = re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{process}/status").read_text())
            memory_bytes = max(memory_bytes, 1024 * int(peak[1]) if peak else 0)
    return cpu_s, memory_bytes


def reset_peak(leader: int) -> None:
    """Reset the peak memory of a process and its children, where the system allows it."""
    with suppress(OSError):
        for process in _family(leader):
            Path(f"/proc/{process}/clear_refs").write_text("5")


def _family(process: int) -> list[int]:
    with suppress(psutil.Error):
        return [process, *(child.pid for child in psutil.Process(process).children(recursive=True))]
    return []


def cores() -> int:
    """Number of cores available to this process."""
    return len(psutil.Process().cpu_affinity()) if psutil.LINUX else psutil.cpu_count() or 1


@contextmanager
def all_stopped() -> Iterator[None]:
    """End the work of other threads, and all that they begin within this context, as Ctrl-C ends it."""
    global _stops
    with _lock:
        _stops += 1
        for stop in _running.values():
            stop()
    try:
        yield
    finally:
        with _lock:
            _stops -= 1


def find_command(words: tuple[str, ...]) -> tuple[str, ...] | None:
    """Command with the path of its first program, found on PATH or next to the interpreter; None if not found.

    The last word gets a path only if it is next to the interpreter and not on PATH; in a container it may be neither.
    """
    beside = str(Path(sys.executable).parent)
    first, last = shutil.which(words[0]) or shutil.which(words[0], path=beside), words[-1]
    if first is None:
        return None
    if not shutil.which(last):
        last = shutil.which(last, path=beside) or last
    return (str(Path(first).absolute()), *words[1:-1], last)[: len(words)]


def line_of(command: tuple[str, ...], option: str, pattern: str) -> str:
    """First line printed by a program with ``option`` that matches ``pattern``; unknown if the program was killed."""
    with tempfile.TemporaryDirectory() as folder:  # LIGGGHTS leaves a log in its folder
        ended = run_command((*command, option), Path(folder), PROBE_LIMIT_S)
        if ended.code < 0:
            return UNKNOWN_VERSION
        lines = (Path(folder) / STDOUT).read_text(errors="replace").splitlines()
    return next((line.strip() for line in lines if re.search(pattern, line)), UNKNOWN_VERSION)


def git(*words: str) -> str:
    """Output of a git command in the checkout; empty if git fails."""
    try:
        done = subprocess.run(("git", *words), cwd=paths.ROOT, capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def local_changes() -> bool:
    """True if the checkout has changed files, or new files in its packages; other new files do not count."""
    new = tuple(f"?? {package}/" for package in paths.PACKAGES)
    return any(line.startswith(new) or not line.startswith("??") for line in git("status", "--porcelain").splitlines())


def kill_group(leader: int) -> None:
    """Kill a process with its group and with the other groups of its session, which mpirun makes."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(leader, signal.SIGKILL)
    for process in psutil.pids():
        with suppress(OSError):
            if os.getsid(process) == leader:
                os.kill(process, signal.SIGKILL)
