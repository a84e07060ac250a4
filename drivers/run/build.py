"""Builds: the programs that engines start, identified by version line and digest of their files.

Two builds of one version may give different numbers, so both are part of a run's identity.
"""

import os
import re
import subprocess
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from shutil import which
from typing import Any

from drivers.base.cache import load, store
from drivers.base.errors import RunError
from drivers.base.files import digest_of_json, readable, sha256_of
from drivers.base.processes import UNKNOWN_VERSION, scrubbed_environment
from drivers.base.terminal import counted
from drivers.engines import Engine

WRAPPER_BYTES = 4000  # a longer script is a program of its own: its words are not names of programs
WORD = re.compile(r"""[^\s'"`;|&()\[\]{}<>=,:$#!]+""")
LIBRARY = re.compile(r"(/.*) \(0x[0-9a-f]+\)$", re.MULTILINE)  # in the output of ldd
_probing = threading.Lock()
_seen: dict[str, dict[str, Any]] = {}  # by key, since the cache may be read-only


@dataclass(frozen=True)
class Build:
    """Installed build.

    Attributes:
        command: command that starts it, with paths of programs.
        version: version line.
        sha256: digest of the programs, those that scripts among them name, their libraries, an external adapter, and
            the variables passed on.
    """

    command: tuple[str, ...]
    version: str
    sha256: str

    @property
    def identity(self) -> str:
        """Text that identifies the build; independent of the folder where it is installed."""
        return "\0".join((*names_of(self.command), self.version, self.sha256))

    @classmethod
    def of_identity(cls, identity: str) -> "Build":
        """Build of another machine, with that identity; its command has names in place of paths."""
        *command, version, sha256 = identity.split("\0")
        return cls(tuple(command), version, sha256)


def names_of(command: Iterable[str]) -> tuple[str, ...]:
    """Words of a command, paths by their last part."""
    return tuple(Path(word).name if "/" in word else word for word in command)


def build_of(engine: Engine) -> Build:
    """Build that an engine starts; cached until its files change, since finding the version starts the program.

    Raises:
        RunError: the engine is not installed.
    """
    command = engine.find()
    if command is None:
        raise RunError(engine.absence)
    if engine.in_repository:  # its version contains the digest of its sources
        return Build(command, engine.version(command), "")
    searched = [os.environ.get(name) for name in ("PATH", "LD_LIBRARY_PATH")]
    passed = sorted(engine.environment.items())
    key = ["build", engine.name, engine.entry.adapter, command, digest_of_json([searched, passed])]  # maybe secret
    with _probing:
        known = _seen.get(str(key)) or load(key)
        if not known or known["files"] != _dates(known["files"]):
            with counted(f"checking the build of {engine.name}"):
                setting = ("env", *(f"{name}={value}" for name, value in passed)) if passed else ()
                version, dates = engine.version((*setting, *command)), _dates(sorted(_files(engine, command)))
                digests = sorted(sha256_of(Path(file)) for file in dates)
            known = {"files": dates, "version": version, "sha256": digest_of_json([*digests, passed])}
            if version != UNKNOWN_VERSION:  # else the probe was disturbed: it is repeated the next time
                _seen[str(key)] = store(key, known)
    return Build(command, known["version"], known["sha256"])


def _dates(files: Iterable[str]) -> dict[str, list[int]]:
    """Size, date and place of each file that can be read."""
    stats = {file: Path(file).stat() for file in files if readable(Path(file))}
    return {file: [stat.st_size, stat.st_mtime_ns, stat.st_ino] for file, stat in stats.items()}


def _files(engine: Engine, command: Iterable[str]) -> set[str]:
    """Programs of a command, an external adapter, programs that scripts among them name, and the libraries of all."""
    adapter = engine.entry.adapter
    waiting, files, folders = [*command, adapter * adapter.endswith(".py")], set[str](), list[str]()
    while waiting:
        word = waiting.pop()
        file = which(word) or word
        if file in files or not (file.startswith("/") and readable(Path(file))):
            continue
        files.add(file)
        content = Path(file).read_bytes()
        text = content.decode(errors="replace") if content.startswith(b"#!") else ""
        script = text if len(text) <= WRAPPER_BYTES else text.partition("\n")[0]
        named = WORD.findall(os.path.expandvars(script.replace("~/", "$HOME/")))
        paths = [*filter(os.path.isabs, named)]
        paths += [f"{folder}/{word}" for folder in (Path(file).parent, *paths) for word in named]
        waiting += filter(which, [*named, *paths])
        folders += filter(os.path.isdir, paths)  # it may set them as LD_LIBRARY_PATH
    libraries = {library for file in files for library in map(str, engine.libraries(Path(file)))}
    if ldd := which("ldd"):
        search = ":".join([*folders, os.environ.get("LD_LIBRARY_PATH", "")])
        given = scrubbed_environment() | engine.environment | {"LD_LIBRARY_PATH": search}
        ended = subprocess.run([ldd, *files], env=given, capture_output=True, check=False)
        libraries.update(LIBRARY.findall(ended.stdout.decode(errors="replace")))
    return files | libraries
