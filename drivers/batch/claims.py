"""Workplaces of batches: folders that exist as long as a live process holds their lock.

The lock is the kernel's: it goes with the process, however that ends. A workplace without it belongs to the dead and
is cleared. Where a file system knows no locks, two batches may run a case twice, which costs time and nothing else.
"""

import fcntl
import json
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

CLAIM = "claim.json"
WORK = ".work"  # of a store: where workplaces are


@dataclass(frozen=True)
class Workplace:
    """A folder of one process at work."""

    folder: Path

    def claim(self, identities: list[str]) -> list[str]:
        """Claims those that no other live process works on, in place of what was claimed before."""
        with _locked(self.folder.parent / "lock"):
            others = claimed(self.folder.parent, self.folder)
            free = [identity for identity in identities if identity not in others]
            draft = self.folder / f".{CLAIM}"
            draft.write_text(json.dumps(free))
            draft.replace(self.folder / CLAIM)
        return free


@contextmanager
def workplace(home: Path) -> Iterator[Workplace]:
    """A workplace below ``home``, gone afterwards."""
    home.mkdir(parents=True, exist_ok=True)
    name = uuid.uuid4().hex[:12]
    draft = home / f".{name}"
    draft.mkdir()
    folder = home / name
    with open(draft / "alive", "w") as alive:
        _held(alive.fileno())
        draft.rename(folder)
        try:
            yield Workplace(folder)
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def claimed(home: Path, own: Path | None = None) -> set[str]:
    """What live processes work on; the workplaces of dead ones are cleared."""
    identities: set[str] = set()
    for folder in home.glob("[!.]*/"):
        if folder == own:
            continue
        try:
            with open(folder / "alive", "r+") as alive:
                held = _held(alive.fileno())
                if held:
                    identities |= set(json.loads((folder / CLAIM).read_text()))
                elif held is not None:
                    shutil.rmtree(folder, ignore_errors=True)
        except (OSError, ValueError):
            continue  # it is just beginning or just ending
    return identities


def _held(handle: int) -> bool | None:
    """Whether somebody else holds the lock; it is taken if not. None: this file system knows no locks."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return None
    return False


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    handle = os.open(path, os.O_RDWR | os.O_CREAT)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
        except OSError:
            pass  # no locks here
        yield
    finally:
        os.close(handle)
