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
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cache, wraps
from importlib import import_module, util
from pathlib import Path
from traceback import extract_tb
from typing import Any, NoReturn

from drivers.base.decks import Deck
from drivers.base.errors import InputError, InputProblem, RunError, one_line
from drivers.base.processes import find_command
from drivers.chain.case import STRAIGHT, Case
from drivers.chain.trace import Trace
from drivers.engines._entries import Entry, entries
from drivers.laws import VISCOELASTIC
from validation.reference.hertz_chain import Flag

REFERENCE, VERLET = "reference", "verlet"  # in-repo engines: exact motion, and the scheme of the codes
IN_HEIGHTS = "velocity Verlet in absolute heights"
IN_OVERLAPS = "velocity Verlet in overlaps"
EXACT = "exact to its tolerance, at any time step"
EXTERNAL = f"{__name__}.at."  # first part of the names of modules of external adapters
TOTAL, INCREMENTAL = "total", "incremental"  # friction that stores the shear displacement, or the shear force

_exit = os._exit


def last_line(stdout: str, stderr: str, chatter: tuple[str, ...] = ()) -> str:
    """Last line with words, of the standard error or else of the output, that does not begin with ``chatter``."""
    lines = [line.strip() for line in f"{stdout}\n{stderr}".splitlines() if re.search(r"\w", line)]
    return ([line for line in lines if not line.startswith(chatter)] or lines or ["no output"])[-1]


def _absolute(word: str) -> str:
    """Word of a command; the path of an existing file is absolute, as a deck runs in a folder of its own."""
    return str(Path(word).absolute()) if "/" in word and "=" not in word and Path(word).exists() else word


@dataclass(frozen=True)
class Style:
    """Colour, line and marker of an engine in figures.

    Attributes:
        colour: as ``#rrggbb``.
        width: width of the line in points.
        dashes: dash pattern of matplotlib.
        marker: marker of matplotlib.
        size: size of the marker in points.
    """

    colour: str
    width: float = 1.3
    dashes: Any = "-"
    marker: str = "^"
    size: float = 5.0


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
            output is damaged. Shapes and signs as in ``drivers.chain.trace.make_trace``.
        loop_pattern: regular expression of the output line with the seconds spent in the code's time loop (group 1).
        server: files and command of a process that runs many decks one after another, requested on its standard
            input. It may end on a deck that fails; the next deck gets a new process.
        request: function of a folder and a word that returns the input by which the server runs the deck of the
            folder and then prints the word on a line and flushes it; for an empty folder it prints the word only.
        integrate: function of a case and a flag that integrates it in this process, for ``verlet`` and ``reference``;
            returns the trace, equal bit for bit to that of the deck, and the seconds of the time loop. Setting the
            flag ends it. None for a code.
        scheme: integration scheme, one of the constants above. Velocity Verlet uses the closing speed of half a step
            before for damping, and at time 0 the one of time 0.
        shear: ``TOTAL`` or ``INCREMENTAL`` friction in three dimensions.
        dissipation: laws of dissipation that it models, as named in scenes; a shipped code asks the laws.
        models: modelling elements (``drivers.chain.case``) that it models.
        variables: environment variables that it needs, with their values.
        refusal: function that returns key, found and allowed of a case that the engine cannot run; else None.
        partial_trace: function that reads the samples of a failed run; None if there are none.
        failure_reason: function that extracts the code's own error message from its standard output and error.
        loss_message: text in the failure reason if a body left the simulated space, which means a blow-up; empty if
            the code does not check for that.
        style: style in figures; None gives the engine a style of its own.
        name, entry: set by ``load_engine``.
    """

    how_to_get: str
    program: str
    version: Callable[[tuple[str, ...]], str]
    render: Callable[[Case], Deck]
    read: Callable[[Case, Path], Trace]
    loop_pattern: str
    server: Deck
    request: Callable[[str, str], str] = lambda folder, word: f"{folder} {word}\n"
    integrate: Callable[[Case, Flag], tuple[Trace, float]] | None = None
    scheme: str = IN_HEIGHTS
    shear: str = TOTAL
    dissipation: frozenset[str] = frozenset({VISCOELASTIC})
    models: frozenset[str] = STRAIGHT
    variables: Mapping[str, str] = field(default_factory=dict)
    refusal: Callable[[Case], InputProblem | None] = lambda case: None
    partial_trace: Callable[[Case, Path], Trace | None] = lambda case, folder: None
    failure_reason: Callable[[str, str], str] = last_line
    loss_message: str = ""
    style: Style | None = None
    libraries: Callable[[Path], Iterable[Path]] = lambda program: ()
    name: str = ""
    entry: Entry = field(default_factory=Entry)

    @property
    def in_repository(self) -> bool:
        """True for an engine that is part of this repository."""
        return self.integrate is not None

    def find(self) -> tuple[str, ...] | None:
        """Command that starts the build, with paths of its programs; None if it is not installed."""
        if self.in_repository:
            return (sys.executable,)
        return next((program for command in self.entry.command if (program := find_command(command))), None)

    def started(self, deck: Deck, build: tuple[str, ...]) -> tuple[str, ...]:
        """Command of a deck, with the program's name replaced by the command of the build."""
        return tuple(word for part in deck.command for word in (build if part == self.program else (part,)))

    def command_by_hand(self, deck: Deck) -> str:
        """Command of a deck for a shell, with the program's name replaced by the command of the engine's entry."""
        registered: tuple[str, ...] = (self.program,)
        if not self.in_repository and self.entry.command:
            registered = next(filter(find_command, self.entry.command), self.entry.command[0])
        return shlex.join(self.started(deck, tuple(map(_absolute, registered))))

    def deck_by_hand(self, deck: Deck) -> Deck:
        """Deck whose first line names ``command_by_hand``, to be written for a reader; all else is unchanged."""
        name, text = next(iter(deck.files.items()))
        first, end, rest = text.partition("\n")
        first = first.replace(" ".join(deck.command), self.command_by_hand(deck))
        return replace(deck, files={**deck.files, name: f"{first}{end}{rest}"})

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables that the engine needs or its entry passes on, with their values."""
        passed = {
            name: value
            for name, value in os.environ.items()
            if any(fnmatchcase(name, pattern) for pattern in self.entry.variables)
        }
        return passed | dict(self.variables)

    @property
    def absence(self) -> str:
        """Message for an engine that is not installed."""
        commands = ", ".join(shlex.join(command) for command in self.entry.command)
        where = f" of {self.entry.where}" if self.entry.where else ""
        return f"not installed; it comes with {self.how_to_get} (looked for {commands}{where})"

    def version_of(self, command: tuple[str, ...]) -> str:
        """Version line of a command, in the environment of runs."""
        variables = [f"{name}={value}" for name, value in self.environment.items()]
        return self.version(("env", *variables, *command) if variables else command)

    def loop_seconds(self, stdout: str) -> float | None:
        """Seconds spent in the code's time loop, from its standard output; None if the run did not finish.

        A deck with several runs of the code has a line for each.
        """
        matches = list(re.finditer(self.loop_pattern, stdout, re.MULTILINE))
        try:
            return sum(float(match[1]) for match in matches) if matches else None
        except (IndexError, TypeError, ValueError) as error:  # of an external adapter
            raise RunError(f"loop_pattern of {self.name} finds no seconds: {error}") from error


@cache
def _adapters() -> tuple[str, ...]:
    return tuple(module.name for module in pkgutil.iter_modules(__path__) if not module.name.startswith("_"))


def load_engine(name: str, where: str = "engine", key: str = "", also: tuple[str, ...] = ()) -> Engine:
    """Load an engine by name.

    Args:
        name: name of the engine.
        where: file or option that names it, for messages.
        key: key in that file, for messages.
        also: further words that the option allows.

    Raises:
        InputError: unknown name, an adapter that cannot be loaded, or an entry for an in-repo engine.
    """
    known = entries(_adapters())
    if name not in known:
        advice = "; own engines are read from ./engines.toml, ~/.config/bead-chains/engines.toml and --engines FILE"
        raise InputError(where, key, f'"{name}"', ", ".join((*sorted(known), *also)) + advice)
    return _engine_of(name, known[name])


@cache
def _engine_of(name: str, entry: Entry) -> Engine:
    """Engine of an entry, cached since a batch loads it for every case."""
    if entry.adapter in _adapters():
        engine = import_module(f"{__name__}.{entry.adapter}").ENGINE
    else:
        engine = _external_adapter(Path(entry.adapter), f"{entry.where}: {name}")
    assert isinstance(engine, Engine)
    if engine.in_repository and entry.where:
        allowed = "an adapter of a code; in-repo engines take no entry"
        raise InputError(entry.where, name, f'adapter "{entry.adapter}"', allowed)
    return replace(engine, name=name, entry=entry, how_to_get=entry.how_to_get or engine.how_to_get)


def _guarded(name: str, function: Callable[..., Any], path: Path) -> Callable[..., Any]:
    """Wrap a function of an external adapter: any error becomes a RunError with its file and line."""

    @wraps(function)
    def guarded(*arguments: Any) -> Any:
        try:
            result = function(*arguments)
            if result is None and name not in ("refusal", "partial_trace"):
                raise RunError(f"{path.name}: {name} returns None")
            return list(result) if isinstance(result, Iterator) else result  # a generator raises errors when it is read
        except (InputError, RunError, KeyboardInterrupt):
            raise
        except BaseException as error:
            raise RunError(_error_line(error, path)) from error

    return guarded


def _error_line(error: BaseException, path: Path) -> str:
    """Error of an adapter on one line, with the last line of its file that was running."""
    lines = [f":{frame.lineno}" for frame in extract_tb(error.__traceback__) if frame.filename == str(path)]
    return one_line(path.name, *lines[-1:], ": ", f"{type(error).__name__}: {error}")


def _exit_unless_adapter(status: int) -> NoReturn:
    """Take the place of ``os._exit`` in adapters, where it would end a command without a word."""
    if sys._getframe(1).f_globals.get("__name__", "").startswith(EXTERNAL):
        raise SystemExit(f"os._exit({status})")
    _exit(status)


@cache
def _external_adapter(path: Path, where: str) -> Engine:
    """Engine of an adapter outside this package.

    Raises:
        InputError: the file cannot be loaded or defines no ``ENGINE``.
    """
    os._exit = _exit_unless_adapter
    spec = util.spec_from_file_location(f"{EXTERNAL}{path}", path)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
        engine = module.ENGINE
        if not isinstance(engine, Engine):
            raise TypeError(f"ENGINE is {type(engine).__name__}")
        re.compile(engine.loop_pattern)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # any error of the adapter
        raise InputError(where, "adapter", _error_line(error, path), "ENGINE = Engine(...)") from error
    guarded: dict[str, Any] = {
        name: _guarded(name, function, path) for name, function in vars(engine).items() if callable(function)
    }
    return replace(engine, **guarded)


def engine_names() -> list[str]:
    """Names of all engines, installed or not."""
    return sorted(entries(_adapters()))


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


def missing_codes() -> list[str]:
    """Names of codes that are not installed."""
    return [name for name in codes() if name not in installed_codes()]
