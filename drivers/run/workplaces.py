"""Workplaces: folders that exist as long as a live process holds their lock, with the rows it has leased.

On one machine the lock is the kernel's: it goes with the process, however that ends, and the workplace of a dead one is
cleared. Of other machines a shared file system may or may not show the locks, so there a workplace is alive as long as
its process touches it. At worst two batches run a case twice, which costs time and nothing else.
"""

import fcntl
import json
import os
import platform
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from drivers.base.files import whole_file

LEASE = "lease.json"
ALIVE = "alive"
ALIVE_S = 120.0  # a workplace of another machine touched within this is alive
ABANDONED_S = 86400.0


@contextmanager
def workplace(home: Path) -> Iterator[Path]:
    """A folder to work in below ``home``, gone afterwards; those of the dead are cleared."""
    home.mkdir(parents=True, exist_ok=True)
    leased(home)
    folder = home / f".{uuid.uuid4().hex[:12]}@{_machine()}"
    folder.mkdir()
    with open(folder / "unlocked", "w") as alive:
        with suppress(OSError):  # no locks here: it is alive as long as it is touched
            fcntl.flock(alive.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        (folder / "unlocked").rename(folder / ALIVE)
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def show_alive(place: Path) -> None:
    """Touches a workplace, for other machines to see."""
    os.utime(place / ALIVE)


def lease(place: Path, identities: set[str]) -> set[str]:
    """Leases the rows that no other live process works on, in place of what was leased before."""
    with open(place.parent / "lock", "a") as file:
        with suppress(OSError):  # no locks here
            fcntl.flock(file.fileno(), fcntl.LOCK_EX)
        free = identities - leased(place.parent, place)
        with whole_file(place / LEASE) as draft:
            draft.write_text(json.dumps(sorted(free)))
    return free


def leased(home: Path, own: Path | None = None) -> set[str]:
    """Rows that live processes work on; the workplaces of dead ones are cleared."""
    identities: set[str] = set()
    for folder in home.glob(".*@*"):
        with suppress(OSError, ValueError):  # it is just beginning or just ending, or no place of leases
            if folder != own and (alive := _alive(folder)):
                identities |= set(json.loads((folder / LEASE).read_text()))
            elif folder != own and alive is False:
                shutil.rmtree(folder, ignore_errors=True)
    return identities


def leftovers(home: Path) -> list[Path]:
    """Workplaces whose processes are certainly dead, which ``leased`` clears."""
    found = []
    for folder in home.glob(".*@*"):
        with suppress(OSError):
            found += [folder] * (_alive(folder) is False)
    return found


def _alive(folder: Path) -> bool | None:
    """Whether the process of a workplace is alive; None where nobody knows."""
    age_s = time.time() - (folder / ALIVE).stat().st_mtime
    if not folder.name.endswith(f"@{_machine()}"):
        return True if age_s < ALIVE_S else False if age_s > ABANDONED_S else None
    with open(folder / ALIVE, "r+") as alive:
        try:
            fcntl.flock(alive.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return True
    return False


def _machine() -> str:
    """This machine since it was started: locks and processes do not outlive that."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()[:8]
    except OSError:
        boot = "boot"
    return f"{platform.node()}-{boot}"
