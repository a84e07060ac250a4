"""Entries of ``engines.toml``: name, adapter and command of an engine."""

import os
import pkgutil
import shlex
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, RootModel

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


class Entry(Part):
    """Table of ``engines.toml``; omitted keys are those of the adapter."""

    adapter: str = Field(default="", description="adapter or .py file; else NAME")
    command: Annotated[tuple[tuple[str, ...], ...], BeforeValidator(_alternatives)] = Field(
        default=(), description="command, or alternatives in order"
    )
    variables: tuple[str, ...] = Field(default=(), strict=False, description="environment variables passed on")
    time_limit: units.Duration | None = Field(default=None, description="time limit of a run")
    how_to_get: str = Field(default="", description="advice if the code is missing")


def entry_files() -> tuple[Path, ...]:
    """Files with entries: shipped, the user's, the present folder's, ``--engines``."""
    of_user = home_of(os.environ.get("XDG_CONFIG_HOME") or "~/.config") / "bead-chains" / paths.ENGINES.name
    here = Path(os.getcwd(), paths.ENGINES.name)  # noqa: PTH109 - Path.cwd() takes ten times as long
    files = [path for path in (paths.ENGINES, of_user, here) if os.access(path, os.R_OK)]
    return tuple(dict.fromkeys((*files, *_given())))


def _given() -> list[Path]:
    """Files of the option ``--engines``."""
    return [Path(path).absolute() for path in os.environ.get(paths.ENGINES_VARIABLE, "").split(os.pathsep) if path]


@cache
def entries_of(files: tuple[Path, ...]) -> dict[str, tuple[Entry, str]]:
    """Entries of files, with the file of each for messages, by name; later files take precedence.

    Without an entry each adapter of this folder has the command of its own name.

    Raises:
        InputError: a file is missing or wrong, or one of the present folder could be changed by others.
    """
    modules = [module.name for module in pkgutil.iter_modules([str(Path(__file__).parent)])]
    by_name = {name: (_named(name), "") for name in modules if not name.startswith("_")}
    codes = sorted({*by_name} - {*RESERVED})
    for path in files:
        _check_owner(path, path)
        for name, table in _read(path):
            before, _ = by_name.get(name) or by_name.get(table.adapter) or (_named(name), "")
            adapter = table.adapter or before.adapter
            if adapter.endswith(".py"):
                adapter = str(path.parent / home_of(adapter))
            if adapter not in codes and not (adapter.endswith(".py") and readable(Path(adapter))):
                allowed = f"{', '.join(codes)}, or the path of a .py file"
                raise InputError(paths.shown(path), f"{name}.adapter", f'"{adapter}"', allowed)
            _check_owner(Path(adapter), path)
            commands = [[_relative_to_file(path, word) for word in words] for words in table.command or before.command]
            filled = {"adapter": adapter, "command": tuple(map(tuple, commands))}
            by_name[name] = table.model_copy(update=filled), paths.shown(path)
    return by_name


def _named(name: str) -> Entry:
    """Entry of an adapter whose command is its name."""
    return Entry.model_construct(adapter=name, command=((name,),))


def _read(path: Path) -> Iterator[tuple[str, Entry]]:
    where, tables = paths.shown(path), read_toml(path)
    validate(RootModel[dict[Name, Any]], tables, where)
    for name, table in tables.items():
        if name in RESERVED:
            raise InputError(where, name, "a reserved name", f"any name except {', '.join(RESERVED)}")
        yield name, validate(Entry, table, where, f"{name}.")


def _relative_to_file(path: Path, word: str) -> str:
    """Word of a command; a relative path is relative to the folder of the entry's file."""
    there = path.parent / home_of(word)
    if "/" not in word or "=" in word or not there.exists():
        return word
    _check_owner(there, path)
    return str(there)


def _check_owner(path: Path, file: Path) -> None:
    """Refuse a path in the present folder, named by its file of entries, that others than the user and root can change.

    A file that was given is the user's word; those of the checkout are part of this program, whoever owns it.
    """
    here = Path.cwd()
    if file.parent != here or file in _given() or file.is_relative_to(paths.ROOT):
        return
    for place in {path.parent, path.resolve(), path.resolve().parent} if path.is_relative_to(here) else ():
        status = place.stat()
        shared = status.st_mode & 0o022 and not status.st_mode & 0o1000  # in /tmp nobody can change files of others
        if shared or status.st_uid not in (0, os.geteuid()):
            allowed = f"one that you alone can change, in such a folder, or --engines {paths.shown(file)}"
            raise InputError(paths.shown(path), "", "a file that others can change", allowed)
