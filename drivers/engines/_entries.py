"""Entries of ``engines.toml``: name, adapter and command of an engine."""

import os
import shlex
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Annotated

from pydantic import BeforeValidator, Field, TypeAdapter, ValidationError

from drivers.base import paths, units
from drivers.base.errors import InputError
from drivers.base.files import home_of, readable
from drivers.base.messages import validate
from drivers.scene.model import Name, Part
from drivers.scene.read_scene import read_toml

RESERVED = ("auto", "batch", "reference", "verlet")  # a value of --engine, a folder of runs/, the in-repo engines


def _alternatives(value: object) -> tuple[tuple[str, ...], ...]:
    lines = [value] if isinstance(value, str) else value
    if isinstance(lines, list) and lines and all(isinstance(line, str) and "\0" not in line for line in lines):
        with suppress(ValueError):  # an open quote
            commands = tuple(tuple(shlex.split(line)) for line in lines)
            if all(commands):
                return commands
    raise ValueError('a command such as "mpirun -np 1 lmp", or a list of them')


def engines_again() -> list[str]:
    """The given option ``--engines``, for a command line that repeats this one."""
    given = os.environ.get(paths.ENGINES_VARIABLE)
    return ["--engines", given] if given else []


class EntryTable(Part):
    """Table of ``engines.toml``; omitted keys are those of the adapter."""

    adapter: str = Field(default="", description="adapter or .py file; else NAME")
    command: Annotated[tuple[tuple[str, ...], ...], BeforeValidator(_alternatives)] = Field(
        default=(), description="command, or alternatives in order"
    )
    variables: tuple[str, ...] = Field(default=(), strict=False, description="environment variables passed on")
    time_limit: units.Duration | None = Field(default=None, description="time limit of a run")
    how_to_get: str = Field(default="", description="advice if the code is missing")


class Entry(EntryTable):
    """Entry of an engine: its table with adapter and command filled in.

    Attributes:
        where: file of the entry, for messages; empty for an adapter without an entry.
    """

    where: str = ""


def entry_files() -> tuple[Path, ...]:
    """Files with entries: shipped, the user's, the present folder's, ``--engines``; later files take precedence.

    They are looked for once in each folder and environment, since a batch asks several times for each case.

    Raises:
        InputError: others than the user and root can change the file of the present folder.
    """
    here = os.getcwd()  # noqa: PTH109 - Path.cwd() takes ten times as long
    variables = ("XDG_CONFIG_HOME", "HOME", paths.ENGINES_VARIABLE)
    return _files_for(here, *(os.environ.get(name, "") for name in variables))


@cache
def _files_for(here: str, settings: str, _: str, added: str) -> tuple[Path, ...]:
    of_user = home_of(settings or "~/.config") / "bead-chains" / paths.ENGINES.name
    files = [path for path in (paths.ENGINES, of_user, Path(here, paths.ENGINES.name)) if os.access(path, os.R_OK)]
    for path in files:
        _check_owner(path, path)
    return tuple(dict.fromkeys((*files, *_given(added))))


def _given(added: str) -> list[Path]:
    return [Path(path).absolute() for path in added.split(os.pathsep) if path]


def _check_owner(path: Path, file: Path) -> None:
    """Refuse a path in the present folder, named by its file of entries, that others than the user and root can change.

    A file that was given is the user's word; those of the checkout are part of this program, whoever owns it.
    """
    here, given = Path.cwd(), _given(os.environ.get(paths.ENGINES_VARIABLE, ""))
    if file.parent != here or file in given or file.is_relative_to(paths.ROOT):
        return
    for place in {path.parent, path.resolve(), path.resolve().parent} if path.is_relative_to(here) else ():
        status = place.stat()
        shared = status.st_mode & 0o022 and not status.st_mode & 0o1000  # in /tmp nobody can change files of others
        if shared or status.st_uid not in (0, os.geteuid()):
            allowed = f"one that you alone can change, in such a folder, or --engines {paths.shown(file)}"
            raise InputError(paths.shown(path), "", "a file that others can change", allowed)


def use_entries(files: Iterable[Path]) -> None:
    """Use the entries of these files in this process and its child processes, in any folder."""
    os.environ[paths.ENGINES_VARIABLE] = os.pathsep.join(map(str, files))


def entries(adapters: tuple[str, ...]) -> dict[str, Entry]:
    """Entries by name; without an entry, each of the package's ``adapters`` has the command of its own name.

    Raises:
        InputError: a file is missing or wrong, or one of the present folder could be changed by others.
    """
    return _entries(adapters, entry_files())


@cache
def _entries(adapters: tuple[str, ...], files: tuple[Path, ...]) -> dict[str, Entry]:
    by_name = {name: Entry.model_construct(adapter=name, command=((name,),)) for name in adapters}
    for path in files:
        for name, table in _read(path):
            where, before = paths.shown(path), by_name.get(name)
            adapter = table.adapter or (before.adapter if before else name)
            if adapter.endswith(".py"):
                adapter = str(path.parent / home_of(adapter))
            if adapter not in adapters and not (adapter.endswith(".py") and readable(Path(adapter))):
                allowed = f"{', '.join(sorted({*adapters} - {*RESERVED}))}, or the path of a .py file"
                raise InputError(where, f"{name}.adapter", f'"{adapter}"', allowed)
            _check_owner(Path(adapter), path)
            known = before or by_name.get(adapter)
            commands = table.command or (known.command if known else ((name,),))
            commands = tuple(tuple(_relative_to_file(path, word) for word in words) for words in commands)
            filled = {"adapter": adapter, "command": commands, "where": where}
            by_name[name] = Entry.model_construct(**dict(table) | filled)
    return by_name


def _read(path: Path) -> Iterator[tuple[str, EntryTable]]:
    where, names = paths.shown(path), TypeAdapter(Name)
    for name, table in read_toml(path).items():
        if name in RESERVED:
            raise InputError(where, name, "a reserved name", f"any name except {', '.join(RESERVED)}")
        try:
            names.validate_python(name)
        except ValidationError:
            allowed = "letters, digits, '-' and '_', beginning with a letter"
            raise InputError(where, name, "not a valid name", allowed) from None
        yield name, validate(EntryTable, table, where, f"{name}.")


def _relative_to_file(path: Path, word: str) -> str:
    """Word of a command; a relative path is relative to the folder of the entry's file."""
    there = path.parent / home_of(word)
    if "/" not in word or "=" in word or not there.exists():
        return word
    _check_owner(there, path)
    return str(there)
