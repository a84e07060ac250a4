"""Workplaces: temporary folders of running processes, with the rows that the process has leased.

A process holds a file lock in its workplace, which the system releases when the process ends in any way; then the
workplace is removed. Locks of other machines may be invisible on a shared file system, so a workplace of another
machine counts as alive as long as its process touches a file in it. In the worst case two batches run the same case,
which costs time only.
"""

import json
import os
import platform
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from drivers.base.files import whole_file

LEASE = "lease.json"
ALIVE = "alive"
ALIVE_S = 120.0  # a workplace of another machine is alive if touched within this time
ABANDONED_S = 86400.0  # and abandoned if not touched for this time
REMOVALS, REMOVAL_S = 20, 0.05  # attempts to remove a folder in which a killed code still removes its own files
NO_LOCKS = (OSError, NotImplementedError)  # on a file system without locks


@contextmanager
def workplace(home: Path) -> Iterator[Path]:
    """Yield a new temporary folder below ``home`` and remove it afterwards; removes those of dead processes."""
    home.mkdir(parents=True, exist_ok=True)
    leased(home)
    folder = home / f".{uuid.uuid4().hex[:12]}@{_machine()}"
    folder.mkdir()
    lock = FileLock(folder / "unlocked", timeout=0)
    try:
        with suppress(*NO_LOCKS):
            lock.acquire()
        (folder / "unlocked").touch()
        (folder / "unlocked").rename(folder / ALIVE)
        yield folder
    finally:
        for _ in range(REMOVALS):
            shutil.rmtree(folder, ignore_errors=True)
            if not folder.exists():
                break
            time.sleep(REMOVAL_S)
        lock.release(force=True)


def show_alive(place: Path) -> None:
    """Touch a workplace, as a sign of life for other machines."""
    os.utime(place / ALIVE)


def lease(place: Path, identities: set[str]) -> set[str]:
    """Lease the rows that no other live process has leased; replaces earlier leases of this workplace."""
    with ExitStack() as stack:
        with suppress(*NO_LOCKS):
            stack.enter_context(FileLock(place.parent / "lock"))
        free = identities - leased(place.parent, place)
        with whole_file(place / LEASE) as draft:
            draft.write_text(json.dumps(sorted(free)))
    return free


def leased(home: Path, except_for: Path | None = None) -> set[str]:
    """Rows leased by live processes; removes the workplaces of dead processes."""
    identities: set[str] = set()
    for folder in home.glob(".*@*"):
        with suppress(OSError, ValueError):  # just starting or ending, or without leases
            if folder != except_for and (alive := _alive(folder)):
                identities |= set(json.loads((folder / LEASE).read_text()))
            elif folder != except_for and alive is False:
                shutil.rmtree(folder, ignore_errors=True)
    return identities


def leftovers(home: Path) -> list[Path]:
    """Workplaces of dead processes, which ``leased`` removes."""
    dead = []
    for folder in home.glob(".*@*"):
        with suppress(OSError):
            dead += [folder] * (_alive(folder) is False)
    return dead


def _alive(folder: Path) -> bool | None:
    """True if the process of a workplace is alive; None if unknown."""
    age_s = time.time() - (folder / ALIVE).stat().st_mtime
    if not folder.name.endswith(f"@{_machine()}"):
        return True if age_s < ALIVE_S else False if age_s > ABANDONED_S else None
    lock = FileLock(folder / ALIVE, timeout=0, is_singleton=False)
    try:
        lock.acquire()
    except Timeout:
        return True
    except NO_LOCKS:
        return None
    lock.release(force=True)
    return False


def _machine() -> str:
    """Name of this machine and its last boot, which ends all locks and processes."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()[:8]
    except OSError:
        boot = "boot"
    return f"{platform.node()}-{boot}"
