"""Engines: one adapter module for each code.

Each module of this folder whose name does not begin with ``_`` is an adapter and defines ``ENGINE = Engine(...)``. An
engine is an adapter with the command that starts a build of its code. ``engines.toml`` adds engines, with adapters of
this folder or of other files.
"""

import os
import pkgutil
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cache, wraps
from importlib import import_module
from pathlib import Path
from runpy import run_path
from traceback import extract_tb
from typing import Annotated, Any, NoReturn

from pydantic import BeforeValidator, Field, RootModel

from drivers.base import paths, units
from drivers.base.decks import Deck
from drivers.base.errors import InputError, InputProblem, RunError, one_line
from drivers.base.files import readable
from drivers.base.messages import validate
from drivers.base.processes import find_command
from drivers.chain.case import STRAIGHT, Case
from drivers.chain.trace import Trace
from drivers.laws import VISCOELASTIC
from drivers.scene.model import Name, Part
from drivers.scene.read_scene import read_toml
from validation.reference.hertz_chain import Flag
from validation.reference.tube import TOTAL

REFERENCE, VERLET = "reference", "verlet"  # in-repo engines: exact motion, and the scheme of the codes
IN_HEIGHTS = "velocity Verlet in absolute heights"
IN_OVERLAPS = "velocity Verlet in overlaps"
EXACT = "exact to its tolerance, at any time step"
EXTERNAL = f"{__name__}.at."  # first part of the names of modules of external adapters
RESERVED = ("auto", "batch", REFERENCE, VERLET)  # a value of --engine, a folder of runs/, the in-repo engines

_exit = os._exit
_path = cache(Path)  # a batch asks for the files of entries several times for each case


def last_line(stdout: str, stderr: str, chatter: tuple[str, ...] = ()) -> str:
    """Last line with words, of the standard error or else of the output, that does not begin with ``chatter``."""
    lines = [line.strip() for line in f"{stdout}\n{stderr}".splitlines() if re.search(r"\w", line)]
    return ([line for line in lines if not line.startswith(chatter)] or lines or ["no output"])[-1]


def _alternatives(value: object) -> tuple[tuple[str, ...], ...]:
    lines = [value] if isinstance(value, str) else value
    if isinstance(lines, list) and lines and all(isinstance(line, str) and "\0" not in line for line in lines):
        with suppress(ValueError):  # an open quote
            commands = tuple(tuple(shlex.split(line)) for line in lines)
            if all(commands):
                return commands
    raise ValueError('a command such as "mpirun -np 1 lmp", or a list of them')


class Entry(Part):
    """Table of ``engines.toml``; omitted keys are those of the adapter."""

    adapter: str = Field(default="", description="adapter or .py file; else NAME")
    command: Annotated[tuple[tuple[str, ...], ...], BeforeValidator(_alternatives)] = Field(
        default=(), description="command, or alternatives in order"
    )
    variables: tuple[str, ...] = Field(default=(), strict=False, description="environment variables passed on")
    time_limit: units.Duration | None = Field(default=None, description="time limit of a run")
    how_to_get: str = Field(default="", description="advice if the code is missing")
    optional: bool = Field(default=False, description="true: nothing is said if the code is missing")


@dataclass(frozen=True)
class Engine:
    """Interface of an engine, provided by its adapter module.

    Attributes:
        how_to_get: package to install if the code is missing.
        program: word of the deck's command that is replaced by the command of the build.
        version: function that returns the version line of a build, with date and commit, given its command.
        libraries: function that lists files that a program loads without naming them, such as those of a script.
        render: function that returns the deck of a case, with the command that runs it inside its folder.
        read: function that reads the raw output of a finished run in its folder as a trace and raises RunError if the
            output is damaged, with the trace of the samples before as its ``partial`` if there are any. Shapes and
            signs as in ``drivers.chain.trace.make_trace``.
        read_dump: function that reads a dump of a deck of another hand, of a case, a path, and the names of its columns
            if the user gives them; returns the trace and its significant digits. None for a code without dumps.
        loop_pattern: regular expression of the output line with the seconds spent in the code's time loop (group 1);
            by default that of decks that time their loop themselves.
        server: files and command of a process that runs many decks one after another, requested on its standard
            input. It may end on a deck that fails; the next deck gets a new process.
        request: function of a folder and a word that returns the input by which the server runs the deck of the
            folder and then prints the word on a line and flushes it; for an empty folder it prints the word only.
        integrate: function of a case and a flag that integrates it in this process, for ``verlet`` and ``reference``;
            returns the trace, equal bit for bit to that of the deck, and the seconds of the time loop. Setting the
            flag ends it. None for a code; that of an adapter outside this package is not used.
        scheme: integration scheme, one of the constants above. Velocity Verlet uses the closing speed of half a step
            before for damping, and at time 0 the one of time 0.
        shear: law of friction in three dimensions, one of ``LAWS`` of ``validation.reference.tube``.
        dissipation: names of the laws of dissipation that it models.
        models: modelling elements (``drivers.chain.case``) that it models.
        refusal: function that returns key, found and allowed of a case that the engine cannot run; else None.
        failure_reason: function that extracts the code's own error message from its standard output and error.
        title: name of the code as its authors write it; that of a build of one's own is the name of its entry.
        style: style in figures, ``color``, ``lw``, ``ls``, ``marker`` and ``ms`` of matplotlib; an empty one gives the
            engine a style that no other has.
        name, entry, where: name, entry, and the file that holds it; set by ``load_engine``.
    """

    how_to_get: str
    program: str
    version: Callable[[tuple[str, ...]], str]
    render: Callable[[Case], Deck]
    read: Callable[[Case, Path], Trace]
    server: Deck
    loop_pattern: str = r"^completed \d+ (?:steps|samples) in ([0-9.]+) s$"
    request: Callable[[str, str], str] = lambda folder, word: f"{folder} {word}\n"
    read_dump: Callable[[Case, Path, tuple[str, ...]], tuple[Trace, int]] | None = None
    integrate: Callable[[Case, Flag], tuple[Trace, float]] | None = None
    scheme: str = IN_HEIGHTS
    shear: str = TOTAL
    dissipation: frozenset[str] = frozenset({VISCOELASTIC})
    models: frozenset[str] = STRAIGHT
    refusal: Callable[[Case], InputProblem | None] = lambda case: None
    failure_reason: Callable[[str, str], str] = last_line
    title: str = ""
    style: Mapping[str, Any] = field(default_factory=dict)
    libraries: Callable[[Path], Iterable[Path]] = lambda program: ()
    name: str = ""
    entry: Entry = field(default_factory=Entry)
    where: str = ""

    @property
    def in_repository(self) -> bool:
        """True for an engine that is part of this repository."""
        return self.integrate is not None

    @property
    def in_print(self) -> str:
        """Name in sentences and legends: the title, or the name of a further build."""
        return self.title if self.title and self.entry.adapter == self.name else self.name

    def find(self) -> tuple[str, ...] | None:
        """Command that starts the build, with paths of its programs; None if it is not installed."""
        if self.in_repository:
            return (sys.executable,)
        return next(filter(None, map(find_command, self.entry.command)), None)

    def started(self, deck: Deck, build: tuple[str, ...]) -> tuple[str, ...]:
        """Command of a deck, with the program's name replaced by the command of the build."""
        return tuple(word for part in deck.command for word in (build if part == self.program else (part,)))

    def by_hand(self, deck: Deck) -> Deck:
        """Deck to be written for a reader: its command, also in its first line, starts the build of the entry."""
        registered = (not self.in_repository and self.entry.command) or ((self.program,),)
        command = self.started(deck, next(filter(find_command, registered), registered[0]))
        name, text = next(iter(deck.files.items()))
        text = text.replace(" ".join(deck.command), shlex.join(command), 1)
        return replace(deck, files={**deck.files, name: text}, command=command)

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables that the engine's entry passes on, with their values."""
        patterns = self.entry.variables
        return {name: value for name, value in os.environ.items() if any(fnmatchcase(name, each) for each in patterns)}

    @property
    def absence(self) -> str:
        """Message for an engine that is not installed."""
        commands = ", ".join(shlex.join(command) for command in self.entry.command)
        where = f" of {self.where}" if self.where else ""
        return f"not installed; it comes with {self.how_to_get} (looked for {commands}{where})"

    def loop_seconds(self, stdout: str) -> float | None:
        """Seconds spent in the code's time loop, from its standard output; None if the run did not finish.

        A deck with several runs of the code has a line for each.
        """
        found = re.findall(self.loop_pattern, stdout, re.MULTILINE)
        try:
            return sum(map(float, found)) if found else None
        except (TypeError, ValueError) as error:  # of an external adapter
            raise RunError(f"loop_pattern of {self.name} finds no seconds: {error}") from error


def entry_files() -> tuple[Path, ...]:
    """Files with entries: shipped, the user's, the present folder's, ``--engines``.

    Raises:
        InputError: others than the user and root can change the file of the present folder.
    """
    # functions of os: those of Path fail without a home, and take longer in each row of a batch
    settings = os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config")  # noqa: PTH111
    of_user, here = _path(settings, "bead-chains", paths.ENGINES.name), _path(os.getcwd(), paths.ENGINES.name)  # noqa: PTH109
    files = [path for path in (paths.ENGINES, of_user, here) if os.access(path, os.R_OK)]
    if here in files:
        _check_owner(here, here)
    return tuple(dict.fromkeys((*files, *_given())))


def _given() -> list[Path]:
    """Files of the option ``--engines``."""
    return [Path(path).absolute() for path in os.environ.get(paths.ENGINES_VARIABLE, "").split(os.pathsep) if path]


@cache
def entries_of(files: tuple[Path, ...]) -> dict[str, tuple[Entry, str]]:
    """Entries of files, with the file of each for messages, by name; later files take precedence.

    Without an entry each adapter of this folder has the command of its own name.

    Raises:
        InputError: a file is missing or wrong, or others can change an adapter or a program in the present folder.
    """
    modules = [module.name for module in pkgutil.iter_modules(__path__)]
    by_name = {name: (_named(name), "") for name in modules if not name.startswith("_")}
    codes = sorted({*by_name} - {*RESERVED})
    for path in files:
        for name, table in tables_in(path):
            before, _ = by_name.get(name) or by_name.get(table.adapter) or (_named(name), "")
            adapter = table.adapter or before.adapter
            if adapter.endswith(".py"):
                adapter = str(path.parent / os.path.expanduser(adapter))  # noqa: PTH111, as above
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


def tables_in(path: Path) -> Iterator[tuple[str, Entry]]:
    """Tables of a file of entries by name.

    Raises:
        InputError: the file is missing or wrong.
    """
    where, tables = paths.shown(path), read_toml(path)
    validate(RootModel[dict[Name, Any]], tables, where)
    for name, table in tables.items():
        if name in RESERVED:
            raise InputError(where, name, "a reserved name", f"any name except {', '.join(RESERVED)}")
        yield name, validate(Entry, table, where, f"{name}.")


def _relative_to_file(path: Path, word: str) -> str:
    """Word of a command; a relative path is relative to the folder of the entry's file."""
    there = path.parent / os.path.expanduser(word)  # noqa: PTH111, as above
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


def engines_again() -> list[str]:
    """The given option ``--engines``, for a command line that repeats this one."""
    given = os.environ.get(paths.ENGINES_VARIABLE)
    return ["--engines", given] if given else []


def load_engine(name: str, where: str = "engine", key: str = "", also: tuple[str, ...] = ()) -> Engine:
    """Load an engine by name.

    Args:
        name: name of the engine.
        where: file or option that names it, for messages.
        key: key in that file, for messages.
        also: further words that the option allows.

    Raises:
        InputError: unknown name, or an adapter that cannot be loaded.
    """
    known = entries_of(entry_files())
    if name not in known:
        advice = "; own engines are read from ./engines.toml, ~/.config/bead-chains/engines.toml and --engines FILE"
        raise InputError(where, key, f'"{name}"', ", ".join((*sorted(known), *also)) + advice)
    return _engine_of(name, *known[name])


@cache
def _engine_of(name: str, entry: Entry, where: str) -> Engine:
    """Engine of an entry, cached since a batch loads it for every case."""
    external = entry.adapter.endswith(".py")
    engine = _external(Path(entry.adapter)) if external else import_module(f"{__name__}.{entry.adapter}").ENGINE
    return replace(engine, name=name, entry=entry, where=where, how_to_get=entry.how_to_get or engine.how_to_get)


def _guarded(name: str, function: Callable[..., Any], path: Path) -> Callable[..., Any]:
    """Wrap a function of an external adapter: any error is a RunError of one line, with the last line that ran."""

    @wraps(function)
    def guarded(*arguments: Any) -> Any:
        try:
            result = function(*arguments)
            if result is None and name != "refusal":
                raise RunError(f"{path.name}: {name} returns None")
            return list(result) if isinstance(result, Iterator) else result  # a generator raises when it is read
        except (InputError, RunError, KeyboardInterrupt):
            raise
        except BaseException as error:
            lines = [f":{frame.lineno}" for frame in extract_tb(error.__traceback__) if frame.filename == str(path)]
            raise RunError(one_line(path.name, *lines[-1:], ": ", f"{type(error).__name__}: {error}")) from error

    return guarded


def _exit_unless_adapter(status: int) -> NoReturn:
    """Take the place of ``os._exit`` in adapters, where it would end a command without a word."""
    if sys._getframe(1).f_globals.get("__name__", "").startswith(EXTERNAL):
        raise SystemExit(f"os._exit({status})")
    _exit(status)


def _external(path: Path) -> Engine:
    """Engine of an adapter outside this package.

    Raises:
        InputError: the file cannot be loaded or defines no ``ENGINE``.
    """
    os._exit = _exit_unless_adapter

    def load() -> Engine:
        engine = run_path(str(path), run_name=f"{EXTERNAL}{path}").get("ENGINE")
        if not isinstance(engine, Engine):
            raise TypeError(f"ENGINE is {type(engine).__name__}")
        re.compile(engine.loop_pattern)
        return engine

    try:
        engine: Engine = _guarded("ENGINE", load, path)()
    except (InputError, RunError) as error:
        raise InputError(paths.shown(path), "", str(error), "ENGINE = Engine(...)") from error
    functions = {name: value for name, value in vars(engine).items() if callable(value)}
    guarded: dict[str, Any] = {name: _guarded(name, function, path) for name, function in functions.items()}
    return replace(engine, **guarded | {"integrate": None})


def engine_names() -> list[str]:
    """Names of all engines, installed or not."""
    return sorted(entries_of(entry_files()))


def in_order(names: Iterable[str]) -> list[str]:
    """Names in the order of tables: codes, then in-repo engines and names that are no engines."""
    known = engine_names()
    return sorted(set(names), key=lambda name: (name not in known or load_engine(name).in_repository, name))


def codes() -> list[str]:
    """Names of all engines that are not part of this repository."""
    return [name for name in engine_names() if not load_engine(name).in_repository]


def installed(names: Iterable[str]) -> tuple[str, ...]:
    """Names of installed engines."""
    return tuple(name for name in names if load_engine(name).find() is not None)


def installed_codes() -> list[str]:
    """Names of installed codes."""
    return list(installed(codes()))


def expected_engines() -> list[str]:
    """Names of all engines, without optional codes that are not installed."""
    return [name for name in engine_names() if installed([name]) or not load_engine(name).entry.optional]


def missing_codes() -> list[str]:
    """Names of codes that are not installed, and not optional."""
    return [name for name in expected_engines() if not installed([name])]
