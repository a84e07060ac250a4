"""Files that are there whole or not at all, and known by their digest."""

import hashlib
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A draft beside ``path`` that takes its place once it is written; gone if that fails."""
    draft = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}")
    try:
        yield draft
        draft.replace(path)
    except OSError as error:
        if error.filename in (None, str(draft)):
            error.filename = str(path)  # a full disk does not say which file
        raise
    finally:
        draft.unlink(missing_ok=True)


def sha256_of(path: Path) -> str:
    """Digest of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def readable(path: Path) -> bool:
    """Whether there is such a file, which may be read; that nobody may look there is no error."""
    with suppress(OSError):
        return path.is_file() and os.access(path, os.R_OK)
    return False


def home_of(path: str) -> Path:
    """A path in which ``~`` stands for the home of the user, where there is one."""
    with suppress(RuntimeError):
        return Path(path).expanduser()
    return Path(path)
