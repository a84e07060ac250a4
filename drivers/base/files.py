"""Files: atomic writing, and reading that is a check.

Each file that is read back is as it was written, or is refused: a JSON file holds its own digest, and the record of a
run those of the other files. Tables and pictures in a results folder are outputs that nothing reads back.
"""

import hashlib
import json
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError

DIGEST = "sha256"  # key of the digest in a JSON file
DAMAGED, ALTERED = "a damaged file", "a file that was altered since it was written"


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


def read_file(path: Path, allowed: str) -> bytes:
    """Content of a regular file; a pipe or a device is refused, since reading it might never end.

    Args:
        path: the file.
        allowed: the file that belongs here, for messages.

    Raises:
        FileNotFoundError: no such file.
        InputError: no regular file, or one that cannot be read.
    """
    try:
        if path.exists() and not path.is_file():
            raise InputError(paths.shown(path), "", "a folder" if path.is_dir() else "no regular file", allowed)
        return path.read_bytes()
    except FileNotFoundError:
        raise
    except OSError as error:
        found = f"a file that cannot be read ({error.strerror})"
        raise InputError(paths.shown(path), "", found, allowed) from error


def write_sealed(path: Path, content: dict[str, Any], indent: int | None = None) -> None:
    """Write JSON values with their digest."""
    sealed = content | {DIGEST: digest_of_json(content)}
    with whole_file(path) as draft:
        draft.write_text(json.dumps(sealed, indent=indent) + "\n")


def read_sealed(path: Path, allowed: str) -> dict[str, Any]:
    """JSON values written by ``write_sealed``.

    Raises:
        FileNotFoundError: no such file.
        InputError: the values are not those that were written, or cannot be read.
    """
    content = read_file(path, allowed)
    try:
        values: dict[str, Any] = json.loads(content)
        whole = values.pop(DIGEST) == digest_of_json(values)
    except (ValueError, TypeError, AttributeError, LookupError, RecursionError) as error:
        raise InputError(paths.shown(path), "", DAMAGED, allowed) from error
    if not whole:
        raise InputError(paths.shown(path), "", ALTERED, allowed)
    return values


def digest_of_json(content: Any) -> str:
    """SHA-256 digest of a JSON value."""
    return sha256_in(json.dumps(content))


def sha256_in(content: str | bytes) -> str:
    """SHA-256 digest of a text or of bytes."""
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()


def arrow_in(content: bytes) -> Any:
    """Table of Arrow from the content of a ``.parquet`` file.

    It is read by this thread alone: threads of Arrow that still release their Python objects when the interpreter ends
    abort the process (apache/arrow, issue 34314), some 4 % of short commands.
    """
    from pyarrow import BufferReader
    from pyarrow.parquet import ParquetFile

    return ParquetFile(BufferReader(content)).read(use_threads=False)


def sha256_of(path: Path) -> str:
    """SHA-256 digest of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def readable(path: Path) -> bool:
    """True if this is a file that may be read; a folder without access is no error."""
    return os.path.isfile(path) and os.access(path, os.R_OK)  # noqa: PTH113, since that of Path raises errors
