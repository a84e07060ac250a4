"""Decks: the input files of an engine, rendered from templates that read like decks written by hand."""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import jinja2

from drivers.base import paths


@dataclass(frozen=True)
class Deck:
    """Input of an engine for one case.

    Attributes:
        files: text by file name; the first line of the main file names the command.
        command: argument vector, run inside the folder with the files.
        raw: names of the raw output files that the engine writes into that folder.
        logs: names of further files that it writes there, which are removed unread.
    """

    files: Mapping[str, str]
    command: tuple[str, ...]
    raw: tuple[str, ...]
    logs: tuple[str, ...] = ()

    @cached_property
    def sha256(self) -> str:
        """Digest of the command and of all files with their names."""
        digest = hashlib.sha256("\0".join(self.command).encode())
        for name, text in sorted(self.files.items()):
            digest.update(f"\0{name}\0{text}".encode())
        return digest.hexdigest()

    def write(self, folder: Path) -> list[Path]:
        """Write the files into a folder and return their paths."""
        for name, text in self.files.items():
            (folder / name).write_text(text)
        return [folder / name for name in self.files]


def render(template: str | Path, **values: object) -> str:
    """Fill in a template, named relative to ``templates/`` or by path; a missing value is an error."""
    path = paths.TEMPLATES / template
    folder = path.parent if isinstance(template, Path) else paths.TEMPLATES
    return _environment(folder).get_template(str(path.relative_to(folder))).render(values)


@cache
def _environment(folder: Path) -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=jinja2.select_autoescape(enabled_extensions=("html.j2",), default=False),
    )
    environment.filters["num"] = exact
    environment.filters["nums"] = _numbers
    environment.filters["rows"] = lambda rows: "\n".join(_numbers([n, *row]) for n, row in enumerate(rows.tolist(), 1))
    return environment


def exact(value: float) -> str:
    """Shortest decimal number that reads back as the same double."""
    return repr(float(value)).removesuffix(".0")


def _numbers(values: Iterable[float], between: str = " ") -> str:
    return between.join(map(exact, values))
