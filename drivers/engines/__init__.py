"""Engines: an adapter for each code, found by its file's name, so that a further engine touches nothing else.

The module of an adapter defines ``ENGINE = Engine(...)``; names that begin with ``_`` are none of an adapter. An engine
is an adapter with the command that starts a build of its code; ``engines.toml`` adds engines, and adapters elsewhere.
"""

import os
import pkgutil
import re
import shlex
import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cache, wraps
from importlib import import_module, util
from pathlib import Path
from traceback import extract_tb
from typing import Any

from drivers.base.decks import Deck
from drivers.base.errors import InputError, InputProblem, RunError
from drivers.base.processes import find_command
from drivers.chain.case import Case
from drivers.chain.elements import STRAIGHT
from drivers.chain.trace import Trace
from drivers.engines._entries import Entry, entries
from drivers.scene.model import VISCOELASTIC

REFERENCE, VERLET = "reference", "verlet"  # this repository's: exact forces, and the codes' scheme
IN_HEIGHTS = "velocity Verlet in absolute heights"
IN_OVERLAPS = "velocity Verlet in overlaps"
EXACT = "exact to its tolerance, whatever the time step"
TOTAL, INCREMENTAL = "total", "incremental"  # the shear displacement, or the force


def last_line(stdout: str, stderr: str, chatter: tuple[str, ...] = ()) -> str:
    """The last line of words that does not begin with any of ``chatter``: of the standard error, else of the output."""
    lines = [line.strip() for line in f"{stdout}\n{stderr}".splitlines() if re.search(r"\w", line)]
    return ([line for line in lines if not line.startswith(chatter)] or lines or ["no output"])[-1]


@dataclass(frozen=True)
class Style:
    """Colour, line and marker of an engine in figures.

    Attributes:
        colour: as ``#rrggbb``.
        width: of the line, in points.
        dashes: as matplotlib takes them.
        marker: matplotlib's letter.
        size: of the marker, in points.
    """

    colour: str
    width: float = 1.3
    dashes: Any = "-"
    marker: str = "^"
    size: float = 5.0


@dataclass(frozen=True)
class Defaults:
    """What a code takes where a deck says nothing, by which a forgotten line is found out; None where it refuses.

    Attributes:
        local_damping: d of Cundall's non-viscous damping, ``a (1 - d sign(a v))``.
        wall_stiffness: of a sphere's contact with a wall, over that of a plane.
    """

    youngs_modulus_Pa: float | None = None
    poisson_ratio: float | None = None
    local_damping: float | None = None
    wall_stiffness: float | None = None


@dataclass(frozen=True)
class Engine:
    """Interface of an engine: what an adapter module provides, in values and functions.

    Attributes:
        how_to_get: what to install where it is missing.
        program: the word of its commands that stands for its program; the command of the build takes its place.
        version: line with the version, date and commit of a build, asked of the command that starts it.
        libraries: files that a program loads and its own file does not name, such as those of a script that starts it.
        render: deck of a case, complete with the command that runs it inside its folder.
        read: raw output of a finished run in its folder, as a trace; a RunError says what is wrong with it. Shapes and
            signs are those of ``drivers.chain.trace.make_trace``.
        loop_pattern: regular expression of the line that gives the seconds in its own time loop, its first group.
        server: files, if any, and command of a process that runs many decks, asked over its standard input; every
            engine has one. It may end on a deck that fails: the next one gets a new process.
        request: input for the server to run the deck of a folder beside its own files, and then to print a word on a
            line and flush it; for an empty folder, at the start, to print the word only.
        in_repository: whether it is part of this repository, and so a yardstick for the others.
        scheme: integration scheme, one of those named above, which its runs are measured against. In velocity Verlet,
            damping has the closing speed of half a step before, and at time 0 that of time 0.
        shear: what its friction keeps in three dimensions, ``TOTAL`` or ``INCREMENTAL``.
        dissipation: laws by which its contacts can lose energy, as scenes name them.
        models: modelling elements (``drivers.chain.elements``) that it can take.
        variables: environment variables that it needs, with their values.
        refusal: key, what was found and what is allowed, where it cannot take a case; else None.
        partial_trace: samples of a run that ended badly; None where there are none.
        failure_reason: the engine's own words for a bad end, from its standard output and error.
        loss_message: words of the failure reason when a body left the space it watches, which is a blow-up; empty where
            it watches none.
        on_two_cores: a deck changed so that it runs on two cores; None where the engine cannot.
        precise_builds: executables beside its own that compute in higher precision, each with the number of beads up
            to which a few steps take seconds.
        defaults: what it takes where a deck says nothing.
        style: its look in figures; None gives it one that no other engine has.
        name, adapter, entry: of the engine; ``load_engine`` fills them in.
    """

    how_to_get: str
    program: str
    version: Callable[[tuple[str, ...]], str]
    render: Callable[[Case], Deck]
    read: Callable[[Case, Path], Trace]
    loop_pattern: str
    server: Deck
    request: Callable[[str, str], str] = lambda folder, word: f"{folder} {word}\n"
    in_repository: bool = False
    scheme: str = IN_HEIGHTS
    shear: str = TOTAL
    dissipation: frozenset[str] = frozenset({VISCOELASTIC})
    models: frozenset[str] = STRAIGHT
    variables: Mapping[str, str] = field(default_factory=dict)
    refusal: Callable[[Case], InputProblem | None] = lambda case: None
    partial_trace: Callable[[Case, Path], Trace | None] = lambda case, folder: None
    failure_reason: Callable[[str, str], str] = last_line
    loss_message: str = ""
    on_two_cores: Callable[[Deck], Deck] | None = None
    precise_builds: Mapping[str, int] = field(default_factory=dict)
    defaults: Defaults = Defaults()
    style: Style | None = None
    libraries: Callable[[Path], Iterable[Path]] = lambda program: ()
    name: str = ""
    entry: Entry = field(default_factory=lambda: Entry("", ()))

    def find(self) -> tuple[str, ...] | None:
        """Words of the command that starts it, programs with their paths; None where it is not installed."""
        if self.in_repository:
            return (sys.executable,)
        return next((found for words in self.entry.commands if (found := find_command(words))), None)

    def started(self, deck: Deck, build: tuple[str, ...]) -> tuple[str, ...]:
        """The command of a deck, with the command of the build in place of the program's name."""
        return tuple(word for each in deck.command for word in (build if each == self.program else (each,)))

    @property
    def environment(self) -> dict[str, str]:
        """Environment variables that it needs or its entry passes through, with their values."""
        passed = {
            name: value
            for name, value in os.environ.items()
            if any(fnmatchcase(name, pattern) for pattern in self.entry.variables)
        }
        return passed | dict(self.variables)

    @property
    def absence(self) -> str:
        """That it is not there, in words for people."""
        words = ", ".join(shlex.join(words) for words in self.entry.commands)
        where = f" of {self.entry.where}" if self.entry.where else ""
        return f"not installed; it comes with {self.how_to_get} (looked for {words}{where})"

    def version_of(self, command: tuple[str, ...], **more: str) -> str:
        """Version line of a command, asked in the environment of its runs, and with ``more`` variables."""
        variables = [f"{name}={value}" for name, value in (self.environment | more).items()]
        return self.version(("env", *variables, *command) if variables else command)

    def loop_seconds(self, stdout: str) -> float | None:
        """Seconds in its own time loop, by its standard output; None where it did not get to the end."""
        match = re.search(self.loop_pattern, stdout, re.MULTILINE)
        return float(match.group(1)) if match else None


@cache
def _adapters() -> tuple[str, ...]:
    return tuple(module.name for module in pkgutil.iter_modules(__path__) if not module.name.startswith("_"))


def load_engine(name: str, where: str = "engine", key: str = "", also: tuple[str, ...] = ()) -> Engine:
    """The engine of a name, which stands in a file or an option ``where``, which may hold other words ``also``.

    Raises:
        InputError: there is none, its adapter cannot be loaded, or its entry is one of this repository's engines.
    """
    known = entries(_adapters())
    if name not in known:
        raise InputError(where, key, f'"{name}"', ", ".join((*sorted(known), *also)))
    return _engine_of(name, known[name])


@cache
def _engine_of(name: str, entry: Entry) -> Engine:
    """The engine of an entry, put together once: a batch asks for it with every case."""
    if entry.adapter in _adapters():
        engine = import_module(f"{__name__}.{entry.adapter}").ENGINE
    else:
        engine = _adapter_elsewhere(Path(entry.adapter), f"{entry.where}: {name}")
    assert isinstance(engine, Engine)
    if engine.in_repository and entry.where:
        raise InputError(entry.where, name, f'adapter "{entry.adapter}"', "a code: this one is part of the repository")
    return replace(engine, name=name, entry=entry, how_to_get=entry.how_to_get or engine.how_to_get)


def _told(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of an adapter elsewhere, of which any error is a RunError that says where it arose."""

    @wraps(function)
    def told(*arguments: Any) -> Any:
        try:
            return function(*arguments)
        except (InputError, RunError):
            raise
        except (Exception, SystemExit) as error:
            place = extract_tb(error.__traceback__)[-1]
            raise RunError(f"{place.filename}:{place.lineno}: {type(error).__name__}: {error}") from error

    return told


@cache
def _adapter_elsewhere(path: Path, where: str) -> Engine:
    """The engine of an adapter outside the package.

    Raises:
        InputError: it cannot be loaded, or defines none.
    """
    spec = util.spec_from_file_location(f"{__name__}.at.{path}", path)  # a name that no module of the package has
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[spec.name] = util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
        engine = module.ENGINE
        if not isinstance(engine, Engine):
            raise TypeError(f"ENGINE is {type(engine).__name__}")
    except (Exception, SystemExit) as error:  # whatever is wrong with it
        raise InputError(
            where, "adapter", f"{path}: {type(error).__name__}: {error}", "ENGINE = Engine(...)"
        ) from error
    return replace(
        engine,
        render=_told(engine.render),
        read=_told(engine.read),
        partial_trace=_told(engine.partial_trace),
        refusal=_told(engine.refusal),
    )


def engine_names() -> list[str]:
    """All engines there are, installed or not."""
    return sorted(entries(_adapters()))


def in_order(names: Iterable[str]) -> list[str]:
    """Engines as tables show them: the codes by name, then those of this repository and what is none of its engines."""
    known = engine_names()
    return sorted(set(names), key=lambda name: (name not in known or load_engine(name).in_repository, name))


def codes() -> list[str]:
    """The engines to be checked: all but those of this repository."""
    return [name for name in engine_names() if not load_engine(name).in_repository]


def installed(names: Iterable[str]) -> tuple[str, ...]:
    """Those of the engines that are there."""
    return tuple(name for name in names if load_engine(name).find() is not None)


def installed_codes() -> list[str]:
    """The codes that are there."""
    return list(installed(codes()))


def missing_codes() -> list[str]:
    """The codes that are not."""
    return [name for name in codes() if name not in installed_codes()]
