"""Builds: the programs that engines start, told from one another by version line and digest of their files.

Two builds of one version may compute something else, so both are part of a run's identity.
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

from drivers.base.errors import RunError
from drivers.base.files import home_of, readable, sha256_of, whole_file
from drivers.base.processes import UNKNOWN_VERSION
from drivers.engines import Engine

NOTE = ".build.json"
SCRIPT_BYTES = 100_000  # of a script, that are searched for the files it names
WRAPPER_BYTES = 4000  # a script no longer than this may be one of commands: each of its words may be a program
WRITTEN = re.compile(r">+ *\S+")  # what a script writes is not what it starts
WORD = re.compile(r"""[^\s'"`;|&()\[\]{}<>=,:]+""")
LOADED = re.compile(r"(?:calling init|initialize program): (.+)")  # as the dynamic linker of glibc says it
SEARCHED = ("PATH", "LD_LIBRARY_PATH")
_asking = threading.Lock()


@dataclass(frozen=True)
class Build:
    """An installed build.

    Attributes:
        command: words that start it, programs with their paths.
        version: line with which it introduces itself.
        sha256: digest of the programs, of what scripts among them name, of all libraries that they load, of an adapter
            of one's own, and of the variables that are passed on.
    """

    command: tuple[str, ...]
    version: str
    sha256: str

    @property
    def identity(self) -> str:
        """All that its numbers depend on; where it lies is not part of it."""
        words = (Path(word).name if "/" in word else word for word in self.command)
        return "\0".join((*words, self.version, self.sha256))


def build_of(engine: Engine, home: Path) -> Build:
    """The build that an engine starts, looked at once and noted in its ``home``: asking costs a start-up.

    Raises:
        RunError: the engine is not installed.
    """
    command = engine.find()
    if command is None:
        raise RunError(engine.absence)
    if engine.in_repository:  # its version holds the digest of its sources
        return Build(command, engine.version_of(command), "")
    note = home / NOTE
    with _asking:
        try:
            known = json.loads(note.read_text())
            if known["key"] == _key(engine, command, known["key"]["files"]):
                return Build(command, str(known["version"]), str(known["sha256"]))
        except (OSError, ValueError, KeyError, TypeError):
            pass
        with TemporaryDirectory() as folder:
            version = engine.version_of(command, LD_DEBUG="files", LD_DEBUG_OUTPUT=f"{folder}/loaded")
            said = "\n".join(file.read_text(errors="replace") for file in Path(folder).iterdir())
        adapter = [engine.entry.adapter] * engine.entry.adapter.endswith(".py")
        files = sorted(_files(engine, [*command, *adapter, *LOADED.findall(said)]))
        digests = sorted(sha256_of(file) for file in files)
        all_of_it = json.dumps([*digests, sorted(engine.environment.items())])
        build = Build(command, version, hashlib.sha256(all_of_it.encode()).hexdigest())
        if build.version != UNKNOWN_VERSION:  # else ask again next time: it may have been mended
            content = {"key": _key(engine, command, map(str, files)), "version": version, "sha256": build.sha256}
            with suppress(OSError):  # a place where nobody may write: it is looked at again
                home.mkdir(parents=True, exist_ok=True)
                with whole_file(note) as draft:
                    draft.write_text(json.dumps(content, indent=1))
    return build


def files_of(home: Path) -> list[Path]:
    """Files that make the digest of the build that is noted in the ``home`` of its engine."""
    return [Path(file) for file in json.loads((home / NOTE).read_text())["key"]["files"]]


def _key(engine: Engine, command: tuple[str, ...], files: Iterable[str]) -> dict[str, Any]:
    """All that a note depends on, as JSON holds it."""
    stats = {file: Path(file).stat() for file in files}
    changed = {file: [stat.st_size, stat.st_mtime_ns, stat.st_ino] for file, stat in stats.items()}
    variables = sorted(({name: os.environ.get(name, "") for name in SEARCHED} | engine.environment).items())
    told = hashlib.sha256(json.dumps(variables).encode()).hexdigest()  # some are nobody else's business
    return {"command": [*command], "variables": told, "files": changed}


def _files(engine: Engine, words: Iterable[str]) -> set[Path]:
    """Files that are named by words, and by scripts among them."""
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
    """Files that a script names, by their paths or what is left of these beside itself, or as programs."""
    for word in dict.fromkeys(WORD.findall(WRITTEN.sub("", text))):
        if "/" in word:
            path = home_of(os.path.expandvars(word))
            yield from (path, *(script.parent.joinpath(*path.parts[start:]) for start in range(1, len(path.parts))))
        elif len(text) <= WRAPPER_BYTES:
            yield Path(which(word) or word)
