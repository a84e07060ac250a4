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
from contextlib import ExitStack, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from drivers.base.files import whole_file
from drivers.base.processes import workplace as workplace

LEASE = "lease.json"
ALIVE = "alive"
ALIVE_S = 120.0  # a workplace of another machine is alive if touched within this time
ABANDONED_S = 86400.0  # and abandoned if not touched for this time
NO_LOCKS = (OSError, NotImplementedError)  # on a file system without locks


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
    """Name of this machine."""
    return platform.node()
