"""Builds: the programs that engines start, told from one another by version line and digest of their files.

Two builds of one version may compute something else, so both are part of a run's identity.
"""

import hashlib
import json
import os
import re
import subprocess
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from shutil import which
from typing import Any

from drivers.base.errors import RunError
from drivers.base.files import sha256_of, whole_file
from drivers.base.processes import UNKNOWN_VERSION, scrubbed_environment
from drivers.engines import Engine

NOTE = ".build.json"
SCRIPT_BYTES = 100_000  # of a script, that are searched for the programs it starts
NAMED = re.compile(r"(?<![\w/])exec +([\w.+-]+)|((?:[\w.+-]*/)+[\w.+-]+)")
LINKED = re.compile(r"^\s*(?:\S+ => )?(/\S+)", re.MULTILINE)
_asking = threading.Lock()


@dataclass(frozen=True)
class Build:
    """An installed build.

    Attributes:
        command: words that start it, programs with their paths.
        version: line with which it introduces itself.
        sha256: digest of the programs, of those that a script among them starts, and of the libraries they load.
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
        raise RunError(f"not installed; it comes with {engine.how_to_get}")
    if engine.in_repository:  # its version holds the digest of its sources
        return Build(command, engine.version(command), "")
    note = home / NOTE
    with _asking:
        try:
            known = json.loads(note.read_text())
            if known["key"] == _key(command, known["key"]["files"]):
                return Build(command, str(known["version"]), str(known["sha256"]))
        except (OSError, ValueError, KeyError, TypeError):
            pass
        files = sorted(dict.fromkeys(files_of(engine, command)))
        digests = "".join(sorted(sha256_of(file) for file in files))
        build = Build(command, engine.version_of(command), hashlib.sha256(digests.encode()).hexdigest())
        if build.version != UNKNOWN_VERSION:  # else ask again next time: it may have been mended
            home.mkdir(parents=True, exist_ok=True)
            content = {"key": _key(command, map(str, files)), "version": build.version, "sha256": build.sha256}
            with whole_file(note) as draft:
                draft.write_text(json.dumps(content, indent=1))
    return build


def _key(command: tuple[str, ...], files: Any) -> dict[str, Any]:
    """All that a note depends on, as JSON holds it."""
    stats = {file: Path(file).stat() for file in files}
    changed = {file: [stat.st_size, stat.st_mtime_ns, stat.st_ino] for file, stat in stats.items()}
    return {"command": [*command], "libraries": os.environ.get("LD_LIBRARY_PATH", ""), "files": changed}


def files_of(engine: Engine, command: tuple[str, ...]) -> Iterator[Path]:
    """Programs of a command, what scripts among them start, and the libraries that all of these load."""
    waiting, known = (
        [Path(found) for word in command if (found := which(word) or word) and Path(found).is_file()],
        set(),
    )
    while waiting:
        program = waiting.pop()
        if program in known:
            continue
        known.add(program)
        yield program
        yield from engine.libraries(program)
        with program.open("rb") as opened:
            head = opened.read(SCRIPT_BYTES)
        if head.startswith(b"#!"):
            waiting += _started_by(program, head.decode(errors="replace"))
        elif head.startswith(b"\x7fELF"):
            words, environment = ("ldd", str(program)), scrubbed_environment()
            said = subprocess.run(words, env=environment, capture_output=True, text=True, check=False).stdout
            yield from map(Path, LINKED.findall(said))


def _started_by(script: Path, text: str) -> Iterator[Path]:
    """Programs that a script names by their paths, beside itself, or after ``exec``."""
    for bare, path in NAMED.findall(text):
        places = [which(bare) or ""] if bare else [path, script.parent / Path(path).name]
        yield from (place for place in map(Path, places) if place.is_file() and os.access(place, os.X_OK))
