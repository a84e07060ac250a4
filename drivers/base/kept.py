"""Results kept on disk, in files named by a digest of all that they depend on: this program, its inputs, arguments."""

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

MOST = 500  # files; the oldest go
LIBRARIES = ("numpy", "scipy", "numba", "pint")  # that numbers depend on


def kept(depends_on: Any, compute: Callable[[], Any]) -> Any:
    """The result of ``compute``, as JSON holds it: of the same call before, if there was one, else computed and kept.

    Args:
        depends_on: all that the result depends on, as JSON holds it, beside sources, inputs, packages and machine.
        compute: what takes long, and tells nothing but its result.
    """
    name = hashlib.sha256(json.dumps([_program(), depends_on]).encode()).hexdigest()
    path = paths.KEPT / f"{name}.json"
    try:
        (found,) = json.loads(path.read_text())
    except (OSError, ValueError, TypeError):  # there is none, or it is damaged
        text = json.dumps([compute()])
        (found,) = json.loads(text)
        with suppress(OSError):  # a place where nobody may write: it is computed again
            path.parent.mkdir(exist_ok=True)
            with whole_file(path) as draft:
                draft.write_text(text)
            files = sorted(path.parent.glob("[!.]*"), key=lambda file: file.stat().st_mtime)
            for old in files[:-MOST]:
                old.unlink(missing_ok=True)
    return found


@cache
def _program() -> str:
    """Digest of all sources and inputs, with the versions of what computes and the machine, as it rounds."""
    packages = (paths.ROOT / name for name in ("drivers", "postproc", "validation"))
    sources = (file for package in packages for file in package.rglob("*.py") if "tests" not in file.parts)
    digest = hashlib.sha256()
    for file in sorted((*sources, *paths.INPUTS.rglob("*.toml"))):
        digest.update(f"{file.relative_to(paths.ROOT)}\0".encode() + file.read_bytes())
    versions = (f"{name} {version(name)}" for name in LIBRARIES)
    return " ".join((digest.hexdigest(), platform.python_version(), platform.node(), *versions))
