"""Results kept on disk, in files named by a digest of the sources, inputs and arguments that they depend on."""

import hashlib
import json
import platform
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.files import whole_file

MAX_FILES = 500  # beyond these the oldest are removed
LIBRARIES = ("numpy", "scipy", "numba", "pint")  # their versions may change numbers


def kept(depends_on: Any, compute: Callable[[], Any]) -> Any:
    """Result of ``compute``, from the cache or computed and stored there.

    Args:
        depends_on: JSON value with everything the result depends on besides sources, inputs, packages and machine.
        compute: function without side effects that returns a JSON value.
    """
    name = hashlib.sha256(json.dumps([_program(), depends_on]).encode()).hexdigest()
    path = paths.CACHE / f"{name}.json"
    try:
        (found,) = json.loads(path.read_text())
    except (OSError, ValueError, TypeError):  # missing or damaged
        text = json.dumps([compute()])
        (found,) = json.loads(text)
        with suppress(OSError):  # not writable: computed again the next time
            path.parent.mkdir(exist_ok=True)
            with whole_file(path) as draft:
                draft.write_text(text)
            files = sorted(path.parent.glob("[!.]*"), key=lambda file: file.stat().st_mtime)
            for old in files[:-MAX_FILES]:
                old.unlink(missing_ok=True)
    return found


@cache
def _program() -> str:
    """Digest of all sources and inputs, versions of Python and libraries, and the machine's name."""
    versions = (f"{name} {version(name)}" for name in LIBRARIES)
    inputs = content_of(paths.INPUTS.rglob("*.toml"))
    return " ".join((digest_of_sources(), inputs, platform.python_version(), platform.node(), *versions))


@cache
def digest_of_sources() -> str:
    """Digest of all sources of this project, without the tests."""
    packages = (paths.ROOT / name for name in paths.PACKAGES)
    return content_of(file for package in packages for file in package.rglob("*.py") if "tests" not in file.parts)


def content_of(files: Iterable[Path]) -> str:
    """Digest of the names and contents of files; the place of the checkout does not matter."""
    digest = hashlib.sha256()
    for file in sorted(files):
        name = file.relative_to(paths.ROOT) if file.is_relative_to(paths.ROOT) else file.name
        digest.update(f"{name}\0".encode() + file.read_bytes())
    return digest.hexdigest()
