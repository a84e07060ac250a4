"""Engines: one module each, found by its file's name, so that a further engine touches nothing else.

The module of an engine defines ``ENGINE = Engine(...)``; names that begin with ``_`` are none of an engine.
"""

import pkgutil
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

from drivers.base.decks import Deck
from drivers.base.errors import InputProblem
from drivers.chain.case import Case
from drivers.chain.elements import STRAIGHT
from drivers.chain.trace import Trace

REFERENCE, VERLET = "reference", "verlet"  # this repository's: exact forces, and the codes' scheme
IN_HEIGHTS = "velocity Verlet in absolute heights"
IN_OVERLAPS = "velocity Verlet in overlaps"
EXACT = "exact to its tolerance, whatever the time step"
TOTAL, INCREMENTAL = "total", "incremental"  # the shear displacement, or the force


def last_line(stdout: str, stderr: str, chatter: tuple[str, ...] = ()) -> str:
    """The last line that does not begin with any of ``chatter``: of the standard error, else of the output."""
    lines = [line.strip() for line in f"{stdout}\n{stderr}".splitlines() if line.strip()]
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
        find: path of its executable, or None where it is not installed.
        version: version of an executable, part of a run's identity.
        render: deck of a case, complete with the command that runs it inside its folder.
        read: raw output of a finished run in its folder, as a trace; a RunError says what is wrong with it.
        loop_pattern: regular expression of the line that gives the seconds in its own time loop, its first group.
        server: files and command of a process that runs many decks, asked over its standard input.
        request: input for the server to run the deck of a folder and then print a word on a line; without a folder,
            to print the word only.
        in_repository: whether it is part of this repository, and so a yardstick for the others.
        scheme: integration scheme, one of those named above, which its runs are measured against.
        shear: what its friction keeps in three dimensions, ``TOTAL`` or ``INCREMENTAL``.
        models: modelling elements (``drivers.chain.elements``) that it can take.
        variables: environment variables that it needs.
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
    """

    how_to_get: str
    find: Callable[[], Path | None]
    version: Callable[[Path], str]
    render: Callable[[Case], Deck]
    read: Callable[[Case, Path], Trace]
    loop_pattern: str
    server: Deck
    request: Callable[[str, str], str] = lambda folder, word: f"{folder} {word}\n"
    in_repository: bool = False
    scheme: str = IN_HEIGHTS
    shear: str = TOTAL
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

    def loop_seconds(self, stdout: str) -> float | None:
        """Seconds in its own time loop, by its standard output; None where it did not get to the end."""
        match = re.search(self.loop_pattern, stdout, re.MULTILINE)
        return float(match.group(1)) if match else None


def load_engine(name: str) -> Engine:
    """The engine of a name."""
    engine = import_module(f"{__name__}.{name}").ENGINE
    assert isinstance(engine, Engine)
    return engine


def engine_names() -> list[str]:
    """All engines this version knows, installed or not."""
    return sorted(module.name for module in pkgutil.iter_modules(__path__) if not module.name.startswith("_"))


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
