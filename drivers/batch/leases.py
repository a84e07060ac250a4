"""Workplaces of batches: folders that exist as long as a live process holds their lock.

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
from dataclasses import dataclass
from pathlib import Path

from drivers.base.files import whole_file

LEASE = "lease.json"
ALIVE = "alive"
ALIVE_S = 120.0  # a workplace of another machine touched within this is alive
ABANDONED_S = 86400.0
WORK = ".work"  # of a store: where workplaces are


@dataclass(frozen=True)
class Workplace:
    """A folder of one process at work."""

    folder: Path

    def lease(self, identities: set[str]) -> set[str]:
        """Leases the rows that no other live process works on, in place of what was leased before."""
        with _locked(self.folder.parent / "lock"):
            free = identities - leased(self.folder.parent, self.folder)
            with whole_file(self.folder / LEASE) as draft:
                draft.write_text(json.dumps(sorted(free)))
        return free

    def show_alive(self) -> None:
        """Touches the workplace, for other machines to see."""
        os.utime(self.folder / ALIVE)


@contextmanager
def workplace(home: Path) -> Iterator[Workplace]:
    """A workplace below ``home``, gone afterwards."""
    home.mkdir(parents=True, exist_ok=True)
    folder = home / f"{uuid.uuid4().hex[:12]}@{_machine()}"
    draft = folder.with_name(f".{folder.name}")
    draft.mkdir()
    with open(draft / ALIVE, "w") as alive:
        with suppress(OSError):  # no locks here: it is alive as long as it is touched
            fcntl.flock(alive.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        draft.rename(folder)
        try:
            yield Workplace(folder)
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def leased(home: Path, own: Path | None = None) -> set[str]:
    """Rows that live processes work on; the workplaces of dead ones are cleared."""
    identities: set[str] = set()
    for folder in home.glob("*@*"):
        if folder == own:
            continue
        try:
            if _alive(folder):
                identities |= set(json.loads((folder / LEASE).read_text()))
        except (OSError, ValueError):
            continue  # it is just beginning or just ending
    return identities


def _alive(folder: Path) -> bool:
    """Whether the process of a workplace is; clears it if certainly not."""
    age_s = time.time() - (folder / ALIVE).stat().st_mtime
    if not folder.name.endswith(f"@{_machine()}"):
        if age_s > ABANDONED_S:
            shutil.rmtree(folder, ignore_errors=True)
        return age_s < ALIVE_S
    with open(folder / ALIVE, "r+") as alive:
        try:
            fcntl.flock(alive.fileno(), fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            return True
    if not (folder.name.startswith(".") and age_s < ALIVE_S):  # a draft is not locked yet
        shutil.rmtree(folder, ignore_errors=True)
    return False


def _machine() -> str:
    """This machine since it was started: locks and processes do not outlive that."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()[:8]
    except OSError:
        boot = "boot"
    return f"{platform.node()}-{boot}"


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    with open(path, "a") as file:
        with suppress(OSError):  # no locks here
            fcntl.flock(file.fileno(), fcntl.LOCK_EX)
        yield
