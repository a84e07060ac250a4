"""Files: atomic writing, digests, home folders."""

import hashlib
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary path; on success it replaces ``path``, on failure it is removed."""
    draft = path.with_name(f".{path.name}.{os.getpid()}-{threading.get_ident()}")
    try:
        yield draft
        draft.replace(path)
    except OSError as error:
        if error.filename in (None, str(draft)):
            error.filename = str(path)  # the error of a full disk names no file
        raise
    finally:
        draft.unlink(missing_ok=True)


def sha256_of(path: Path) -> str:
    """SHA-256 digest of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def readable(path: Path) -> bool:
    """True if this is a file that may be read; a folder without access is no error."""
    with suppress(OSError):
        return path.is_file() and os.access(path, os.R_OK)
    return False


def home_of(path: str) -> Path:
    """Path with ``~`` replaced by the home of the user, if known."""
    with suppress(RuntimeError):
        return Path(path).expanduser()
    return Path(path)
