"""Processes of engines and their folders: a minimal environment, a time limit, and nothing left when they end."""

import fcntl
import os
import platform
import re
import shutil
import socket
import stat
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import connection
from pathlib import Path
from typing import Any

import psutil

from drivers.base import paths
from drivers.base.errors import InputError

KEPT_VARIABLES = ("PATH", "HOME", "USER", "LOGNAME", "TMPDIR", "LD_LIBRARY_PATH")
PROBE_LIMIT_S = 20.0
UNKNOWN_VERSION = "unknown"
STDOUT, STDERR = "stdout.txt", "stderr.txt"  # output of a process, in its folder

LAUNCHER = Path(__file__).with_name("launcher.py")
POLL_INTERVAL_S = 0.1
PLACE, LOCK = ".bead-chains-", "alive"  # beginning of the names of workplaces, and the lock file in them
ABANDONED_S = 86400.0  # age of a workplace that counts as that of a dead process if its lock says nothing

_stopping = False  # within all_stopped()

# launcher of a command (``drivers.base.launcher``) with the streams of the command, and the socket to the launcher
Launched = tuple[subprocess.Popen[bytes], socket.socket]


@dataclass(frozen=True)
class EndedProcess:
    """End of a process.

    Attributes:
        code: exit code; negative for a signal.
        timed_out: True if it was killed at the time limit.
        limit_s: time limit.
        wall_s, cpu_s: wall and CPU time of the process with its children.
        memory_bytes: peak memory.
    """

    code: int
    timed_out: bool
    limit_s: float
    wall_s: float = 0.0
    cpu_s: float = 0.0
    memory_bytes: int = 0


def scrubbed_environment() -> dict[str, str]:
    """Environment of engines, without the virtual environment: YADE would import its modules."""
    # that of Path fails without a home
    kept = {"HOME": os.path.expanduser("~")} | {name: os.environ[name] for name in KEPT_VARIABLES if name in os.environ}  # noqa: PTH111
    return kept | {"LC_ALL": "C.UTF-8", "PYTHONNOUSERSITE": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}


def run_command(command: tuple[str, ...], folder: Path, limit_s: float, **variables: str) -> EndedProcess:
    """Run a command inside ``folder``; its output goes to ``STDOUT`` and ``STDERR`` there.

    ``variables`` are added to the environment. The process is killed at the time limit, with all that it has started.

    Raises:
        OSError: no process can be started.
        KeyboardInterrupt: all work is being stopped.
    """
    began = time.perf_counter()
    with open(folder / STDOUT, "wb") as out, open(folder / STDERR, "wb") as err:
        process, launcher = start(command, folder, variables, stdin=subprocess.DEVNULL, stdout=out, stderr=err)
        in_time = False
        try:
            in_time = waited(lambda seconds: connection.wait([launcher], seconds), began + limit_s)
        finally:
            code, cpu_s, memory_bytes = end(process, launcher)
    return EndedProcess(code, not in_time, limit_s, time.perf_counter() - began, cpu_s, memory_bytes)


def waited(wait: Callable[[float], object], until_s: float) -> bool:
    """Wait for work under way until a time of ``time.perf_counter``; True if it ended before.

    Args:
        wait: function that waits for so many seconds, and returns something true if the work has ended.
        until_s: the time.

    Raises:
        KeyboardInterrupt: all work is being stopped.
    """
    while (left_s := until_s - time.perf_counter()) > 0:
        if wait(min(left_s, POLL_INTERVAL_S)):
            return True
        if _stopping:
            raise KeyboardInterrupt
    return False


@contextmanager
def all_stopped() -> Iterator[None]:
    """End the work of other threads within this context, as Ctrl-C ends it."""
    global _stopping
    _stopping = True
    try:
        yield
    finally:
        _stopping = False


def start(command: tuple[str, ...], folder: Path, variables: dict[str, str], **streams: Any) -> Launched:
    """Start a command in a session of its own, which ends at ``end`` or with this process, however it ends.

    ``variables`` are added to the environment; ``streams`` are those of ``subprocess.Popen``.

    Raises:
        OSError: no process can be started.
    """
    ours, theirs = socket.socketpair()
    try:
        with theirs:
            process = subprocess.Popen(
                (sys.executable, "-I", "-S", str(LAUNCHER), str(theirs.fileno()), *command),
                cwd=folder,
                env=scrubbed_environment() | variables,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
                **streams,
            )
    except BaseException:  # a signal may come when the launcher has been started
        _report(ours)
        raise
    return process, ours


def end(process: subprocess.Popen[bytes], launcher: socket.socket) -> tuple[int, float, int]:
    """End a command with all that it has started; returns exit code, CPU time in s and peak memory in bytes."""
    with suppress(OSError), process:  # closes its streams, perhaps with input that nobody has read
        code, cpu_s, memory_bytes = _report(launcher) or (process.wait(), 0, 0)
    return int(code), float(cpu_s), int(memory_bytes)


def _report(launcher: socket.socket) -> list[str]:
    """Ask a launcher to end; its report when it has ended, empty if it was killed or could not start the command."""
    with suppress(OSError):  # it has ended
        launcher.shutdown(socket.SHUT_WR)
    with launcher, launcher.makefile() as report:
        return report.read().split()


def cores() -> int:
    """Number of cores available to this process."""
    return len(psutil.Process().cpu_affinity()) if psutil.LINUX else psutil.cpu_count() or 1


@contextmanager
def workplace(home: Path | None = None) -> Iterator[Path]:
    """Yield a new folder below ``home``, else among temporary files, private to this user, and remove it afterwards.

    The folder holds a file lock, which the system releases when the process ends in any way; the next workplace there
    removes the folders of dead processes.
    """
    home = home or private_temporary_folder()
    home.mkdir(parents=True, exist_ok=True)
    remove_abandoned(home)
    folder = Path(tempfile.mkdtemp(f"@{platform.node()}", PLACE, home))
    try:
        with open(folder / "unlocked", "w") as lock:
            with suppress(OSError):  # on a file system without locks
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            (folder / "unlocked").rename(folder / LOCK)
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def remove_abandoned(home: Path) -> None:
    """Remove the workplaces of dead processes."""
    for left in home.glob(f"{PLACE}*"):
        if _is_abandoned(left):
            shutil.rmtree(left, ignore_errors=True)


def _is_abandoned(folder: Path) -> bool:
    """True for a workplace of this user whose process has died; if its lock says nothing here, after a day."""
    with suppress(OSError):  # removed meanwhile
        status, here = folder.lstat(), folder.name.endswith(f"@{platform.node()}")
        if status.st_uid != os.getuid() or not stat.S_ISDIR(status.st_mode):
            return False
        try:
            with open(folder / LOCK, "r+") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:  # just made, or on a file system without locks
            here = False
        dates = [status.st_mtime, *(file.lstat().st_mtime for file in folder.rglob("*"))]
        return here or time.time() - max(dates) > ABANDONED_S
    return False


def private_temporary_folder() -> Path:
    """Folder of temporary files.

    Raises:
        InputError: other users could put files of their own in place of those in it.
    """
    folder = Path(tempfile.gettempdir())
    status = folder.stat()
    if status.st_uid not in (0, os.getuid()) or (status.st_mode & (stat.S_IWOTH | stat.S_ISVTX)) == stat.S_IWOTH:
        raise InputError(f"TMPDIR={folder}", "", "a folder in which others can replace files", "a folder of your own")
    return folder


def find_command(words: tuple[str, ...]) -> tuple[str, ...] | None:
    """Command with the path of its first program, found on PATH or next to the interpreter; None if not found.

    Another word gets a path only if it is next to the interpreter and not on PATH; in a container it may be neither.
    """
    beside = str(Path(sys.executable).parent)
    first = shutil.which(words[0]) or shutil.which(words[0], path=beside)
    if first is None:
        return None
    others = (word if shutil.which(word) else shutil.which(word, path=beside) or word for word in words[1:])
    return (str(Path(first).absolute()), *others)


def line_of(command: tuple[str, ...], option: str, pattern: str) -> str:
    """First line printed by a program with ``option`` that matches ``pattern``; unknown if the program was killed."""
    with workplace() as folder:  # LIGGGHTS leaves a log in its folder
        ended = run_command((*command, option), folder, PROBE_LIMIT_S)
        if ended.code < 0:
            return UNKNOWN_VERSION
        lines = (folder / STDOUT).read_text(errors="replace").splitlines()
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
