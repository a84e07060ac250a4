"""Builds: the programs that engines start, identified by version line and digest of their files.

Two builds of one version may give different numbers, so both are part of a run's identity.
"""

import os
import re
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from shutil import which
from string import Template
from tempfile import TemporaryDirectory
from typing import Any

from drivers.base.errors import RunError
from drivers.base.files import digest_of_json, home_of, readable, sha256_of
from drivers.base.kept import keep, recall
from drivers.base.processes import UNKNOWN_VERSION
from drivers.base.progress import counted
from drivers.engines import Engine

SCRIPT_BYTES = 100_000  # length of a script that is searched for names of files
WRAPPER_BYTES = 4000  # in shorter scripts each word may be the name of a program
WRITTEN = re.compile(r">+ *\S+")  # files that a script writes
ASSIGNED = re.compile(r"^\s*(?:export +)?(\w+)=([^\s;]+)", re.MULTILINE)  # variables of a script
WORD = re.compile(r"""[^\s'"`;|&()\[\]{}<>=,:]+""")
LOADED = re.compile(r"(?:calling init|initialize program): (.+)")  # output of glibc's dynamic linker
SEARCHED = ("PATH", "LD_LIBRARY_PATH")
_probing = threading.Lock()
_seen: dict[str, dict[str, Any]] = {}  # entries of the cache that this process knows, by digest of their key


@dataclass(frozen=True)
class Build:
    """Installed build.

    Attributes:
        command: command that starts it, with paths of programs.
        version: version line.
        sha256: digest of the programs, the files named by scripts among them, all libraries that they load, an external
            adapter, and the variables passed on.
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
        return Build(command, engine.version_of(command), "")
    variables = sorted(({name: os.environ.get(name, "") for name in SEARCHED} | engine.environment).items())
    key = ["build", engine.name, engine.entry.adapter, command, digest_of_json(variables)]  # values may be secret
    name = digest_of_json(key)
    with _probing:
        known = _seen.get(name) or recall(key)
        if known and known["files"] == _dates(known["files"]):
            _seen[name] = known
            return Build(command, known["version"], known["sha256"])
        with counted(f"checking the build of {engine.name}"), TemporaryDirectory() as folder:
            version = engine.version_of(command, LD_DEBUG="files", LD_DEBUG_OUTPUT=f"{folder}/loaded")
            loaded = "\n".join(file.read_text(errors="replace") for file in Path(folder).iterdir())
        adapter = [engine.entry.adapter] * engine.entry.adapter.endswith(".py")
        files = sorted(_files(engine, [*command, *adapter, *LOADED.findall(loaded)]))
        digests = sorted(sha256_of(file) for file in files)
        build = Build(command, version, digest_of_json([*digests, sorted(engine.environment.items())]))
        if build.version != UNKNOWN_VERSION:  # else it is probed again the next time
            entry = {"files": _dates(map(str, files)), "version": version, "sha256": build.sha256}
            _seen[name] = keep(key, entry)
    return build


def _dates(files: Iterable[str]) -> dict[str, list[int]] | None:
    """Size, date and place of each file; None if one is missing."""
    try:
        stats = {file: Path(file).stat() for file in files}
    except OSError:
        return None
    return {file: [stat.st_size, stat.st_mtime_ns, stat.st_ino] for file, stat in stats.items()}


def _files(engine: Engine, words: Iterable[str]) -> set[Path]:
    """Files that words name, and files that scripts among them name."""
    waiting, files = {Path(which(word) or word) for word in words}, set[Path]()
    while waiting:
        file = waiting.pop()
        if file in files or not (file.is_absolute() and readable(file)):
            continue
        files |= {file, *engine.libraries(file)}
        with file.open("rb") as opened:
            head = opened.read(SCRIPT_BYTES)
        if head.startswith(b"#!"):
            waiting.update(_in_script(file, head.decode(errors="replace")))
    return files


def _in_script(script: Path, text: str) -> Iterator[Path]:
    """Files named in a script: paths, the same paths relative to the script's folder, and programs."""
    variables = os.environ | {name: value.strip("\"'") for name, value in ASSIGNED.findall(text)}
    for word in dict.fromkeys(WORD.findall(Template(WRITTEN.sub("", text)).safe_substitute(variables))):
        if "/" in word:
            path = home_of(word)
            yield from (path, *(script.parent.joinpath(*path.parts[start:]) for start in range(1, len(path.parts))))
        elif len(text) <= WRAPPER_BYTES:
            yield Path(which(word) or word)
