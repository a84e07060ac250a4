"""Builds: the programs that engines start, identified by version line and digest of their files.

Two builds of one version may give different numbers, so both are part of a run's identity.
"""

import hashlib
import json
import os
import re
import threading
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory
from typing import Any

from drivers.base import paths
from drivers.base.errors import RunError
from drivers.base.files import home_of, readable, sha256_of, whole_file
from drivers.base.processes import UNKNOWN_VERSION
from drivers.engines import Engine

BUILD_FILE = ".build.json"  # in the folder of an engine's runs
SCRIPT_BYTES = 100_000  # length of a script that is searched for names of files
WRAPPER_BYTES = 4000  # in shorter scripts each word may be the name of a program
WRITTEN = re.compile(r">+ *\S+")  # files that a script writes
WORD = re.compile(r"""[^\s'"`;|&()\[\]{}<>=,:]+""")
LOADED = re.compile(r"(?:calling init|initialize program): (.+)")  # output of glibc's dynamic linker
SEARCHED = ("PATH", "LD_LIBRARY_PATH")
_probing = threading.Lock()


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
        words = (Path(word).name if "/" in word else word for word in self.command)
        return "\0".join((*words, self.version, self.sha256))


def build_of(engine: Engine, home: Path | None = None) -> Build:
    """Build that an engine starts; cached in the engine's ``home``, since finding the version starts the program.

    Raises:
        RunError: the engine is not installed.
    """
    command = engine.find()
    if command is None:
        raise RunError(engine.absence)
    if engine.in_repository:  # its version contains the digest of its sources
        return Build(command, engine.version_of(command), "")
    home = home or paths.RUNS / engine.name
    note = home / BUILD_FILE
    with _probing:
        try:
            known = json.loads(note.read_text())
            if known["key"] == _key(engine, command, known["key"]["files"]):
                return Build(command, str(known["version"]), str(known["sha256"]))
        except (OSError, ValueError, KeyError, TypeError):
            pass
        with TemporaryDirectory() as folder:
            version = engine.version_of(command, LD_DEBUG="files", LD_DEBUG_OUTPUT=f"{folder}/loaded")
            loaded = "\n".join(file.read_text(errors="replace") for file in Path(folder).iterdir())
        adapter = [engine.entry.adapter] * engine.entry.adapter.endswith(".py")
        files = sorted(_files(engine, [*command, *adapter, *LOADED.findall(loaded)]))
        digests = sorted(sha256_of(file) for file in files)
        content = json.dumps([*digests, sorted(engine.environment.items())])
        build = Build(command, version, hashlib.sha256(content.encode()).hexdigest())
        if build.version != UNKNOWN_VERSION:  # else it is probed again the next time
            cached = {"key": _key(engine, command, map(str, files)), "version": version, "sha256": build.sha256}
            with suppress(OSError):  # not writable: probed again the next time
                home.mkdir(parents=True, exist_ok=True)
                with whole_file(note) as draft:
                    draft.write_text(json.dumps(cached, indent=1))
    return build


def _key(engine: Engine, command: tuple[str, ...], files: Iterable[str]) -> dict[str, Any]:
    """Key of the cached build: command, variables and files, as JSON values."""
    stats = {file: Path(file).stat() for file in files}
    changed = {file: [stat.st_size, stat.st_mtime_ns, stat.st_ino] for file, stat in stats.items()}
    variables = sorted(({name: os.environ.get(name, "") for name in SEARCHED} | engine.environment).items())
    digest = hashlib.sha256(json.dumps(variables).encode()).hexdigest()  # values may be secret
    return {"command": [*command], "variables": digest, "files": changed}


def _files(engine: Engine, words: Iterable[str]) -> set[Path]:
    """Files named by words, and by scripts among these files."""
    waiting, found = {Path(which(word) or word) for word in words}, set[Path]()
    while waiting:
        file = waiting.pop()
        if file in found or not (file.is_absolute() and readable(file)):
            continue
        found |= {file, *engine.libraries(file)}
        with file.open("rb") as opened:
            head = opened.read(SCRIPT_BYTES)
        if head.startswith(b"#!"):
            waiting.update(_in_script(file, head.decode(errors="replace")))
    return found


def _in_script(script: Path, text: str) -> Iterator[Path]:
    """Files named in a script: paths, the same paths relative to the script's folder, and programs."""
    for word in dict.fromkeys(WORD.findall(WRITTEN.sub("", text))):
        if "/" in word:
            path = home_of(os.path.expandvars(word))
            yield from (path, *(script.parent.joinpath(*path.parts[start:]) for start in range(1, len(path.parts))))
        elif len(text) <= WRAPPER_BYTES:
            yield Path(which(word) or word)
