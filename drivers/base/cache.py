"""Cache of derived results, each valid until something that it depends on changes.

An entry is a JSON file. Its name is a digest of everything it depends on; it holds the result under this name, and a
digest of itself.
"""

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
from drivers.base.errors import InputError
from drivers.base.files import digest_of_json, read_sealed, write_sealed
from drivers.base.terminal import say

MAX_FILES = 2000  # beyond these the oldest are removed
LIBRARIES = ("numpy", "scipy", "numba", "pint")  # their versions may change numbers


def cached(depends_on: Any, compute: Callable[[], Any]) -> Any:
    """Result of ``compute``, from the cache or computed and stored there.

    Args:
        depends_on: JSON value with everything the result depends on besides sources, inputs, packages and machine.
        compute: function without side effects that returns a JSON value other than null.
    """
    stored = load(depends_on)
    return store(depends_on, compute()) if stored is None else stored


def load(depends_on: Any) -> Any:
    """Result in the cache; None if there is none. A damaged entry is reported and ignored."""
    path = _entry(depends_on)
    try:
        return read_sealed(path, "a result as it was computed")[path.stem]
    except (InputError, LookupError):  # or an entry under the name of another one
        say(f"{paths.shown(path)}: not as it was written: computed again")
    except OSError:
        pass
    return None


def store(depends_on: Any, result: Any) -> Any:
    """Store a result in the cache, and return it as it is read back."""
    path = _entry(depends_on)
    with suppress(OSError):  # not writable: computed again the next time
        path.parent.mkdir(exist_ok=True)
        write_sealed(path, {path.stem: result})
        if len(files := [*path.parent.iterdir()]) > MAX_FILES:
            for old in sorted(files, key=lambda file: file.stat().st_mtime)[:-MAX_FILES]:
                old.unlink(missing_ok=True)
    return json.loads(json.dumps(result))


def _entry(depends_on: Any) -> Path:
    return paths.CACHE / f"{digest_of_json([_program(), depends_on])}.json"


@cache
def _program() -> str:
    """Digest of sources, templates and inputs, versions of Python and libraries, and the machine's name."""
    versions = (f"{name} {version(name)}" for name in LIBRARIES)
    inputs = content_of([*paths.INPUTS.rglob("*.toml"), *paths.INPUTS.rglob("*.csv"), *paths.TEMPLATES.rglob("*.j2")])
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
