"""Results kept on disk, in files named by a digest of the sources, inputs and arguments that they depend on."""

import hashlib
import json
import platform
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from importlib.metadata import version
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
    packages = (paths.ROOT / name for name in ("drivers", "postproc", "validation"))
    sources = (file for package in packages for file in package.rglob("*.py") if "tests" not in file.parts)
    digest = hashlib.sha256()
    for file in sorted((*sources, *paths.INPUTS.rglob("*.toml"))):
        digest.update(f"{file.relative_to(paths.ROOT)}\0".encode() + file.read_bytes())
    versions = (f"{name} {version(name)}" for name in LIBRARIES)
    return " ".join((digest.hexdigest(), platform.python_version(), platform.node(), *versions))
