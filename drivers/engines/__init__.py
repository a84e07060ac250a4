"""Engines: one module each, found by its file's name, so that a further engine touches nothing else.

An engine module has

* ``find()``: path of its executable, or None where it is not installed;
* ``HOW_TO_GET``: what to install then;
* ``IN_REPOSITORY``: whether it is part of this repository, and so a yardstick for the others;
* ``SCHEME``: how it integrates, one of those named below: what its runs are measured against;
* ``SHEAR``: what its friction keeps in three dimensions, ``TOTAL`` or ``INCREMENTAL``;
* ``MODELS``: the modelling elements (``drivers.chain.elements``) that it can;
* ``LOST``: what it says when a body has left the space it watches, which is a blow-up; empty if it watches none;
* ``VARIABLES``: environment variables it needs;
* ``version(executable)``: its version, part of a run's identity;
* ``refusal(case)``: key, what was found and what is allowed, where it cannot take a case; else None;
* ``render(case)``: the deck, complete with the command that runs it inside its folder;
* ``SERVER``: files and command of a process that runs many decks, asked over its standard input;
* ``request(folder, word)``: what to write there, so that it runs the deck of a folder and prints the word on a line;
* ``read(case, folder)``: the raw output there as a force trace, or a RunError saying what is wrong with it;
* ``seen(case, folder)``: what there is of the trace after a run that ended badly, None where that is nothing;
* ``complaint(stdout, stderr)``: the engine's own words for why it ended badly;
* ``loop_seconds(stdout)``: seconds in the engine's own time loop, None where it did not get there.
"""

import pkgutil
from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Protocol, cast

from drivers.base.decks import Deck
from drivers.base.messages import Complaint
from drivers.chain.case import Case
from drivers.chain.trace import Trace

IN_HEIGHTS = "velocity Verlet in absolute heights"
IN_OVERLAPS = "velocity Verlet in overlaps"
EXACT = "exact to its tolerance, whatever the time step"
TOTAL, INCREMENTAL = "total", "incremental"  # the shear displacement, or the force


class Engine(Protocol):
    """What a module of this package offers."""

    HOW_TO_GET: str
    IN_REPOSITORY: bool
    SCHEME: str
    SHEAR: str
    MODELS: frozenset[str]
    LOST: str
    VARIABLES: Mapping[str, str]
    SERVER: Deck

    @staticmethod
    def find() -> Path | None:
        """Path of the executable, None where it is not installed."""
        ...

    @staticmethod
    def version(executable: Path) -> str:
        """Its version."""
        ...

    @staticmethod
    def refusal(case: Case) -> Complaint | None:
        """Why it cannot take the case."""
        ...

    @staticmethod
    def render(case: Case) -> Deck:
        """The deck of a case."""
        ...

    @staticmethod
    def request(folder: str, word: str) -> str:
        """What makes the server run the deck of a folder and say the word; without a folder, just say it."""
        ...

    @staticmethod
    def read(case: Case, folder: Path) -> Trace:
        """The raw output as a trace; RunError where it is not whole."""
        ...

    @staticmethod
    def seen(case: Case, folder: Path) -> Trace | None:
        """The first samples of a run that ended badly."""
        ...

    @staticmethod
    def complaint(stdout: str, stderr: str) -> str:
        """The engine's own words for why it ended badly."""
        ...

    @staticmethod
    def loop_seconds(stdout: str) -> float | None:
        """Seconds in its own time loop."""
        ...


def engine_names() -> list[str]:
    """All engines this version knows, installed or not."""
    return sorted(module.name for module in pkgutil.iter_modules(__path__) if not module.name.startswith("_"))


def in_order(names: Iterable[str]) -> list[str]:
    """Engines as tables show them: the codes by name, then those of this repository and what is none of its engines."""
    known = engine_names()
    return sorted(set(names), key=lambda name: (name not in known or load_engine(name).IN_REPOSITORY, name))


def codes() -> list[str]:
    """The engines to be checked: all but those of this repository."""
    return [name for name in engine_names() if not load_engine(name).IN_REPOSITORY]


def installed(names: Iterable[str]) -> tuple[str, ...]:
    """Those of the engines that are there."""
    return tuple(name for name in names if load_engine(name).find() is not None)


def installed_codes() -> list[str]:
    """The codes that are there."""
    return list(installed(codes()))


def missing_codes() -> list[str]:
    """The codes that are not."""
    return [name for name in codes() if name not in installed_codes()]


def load_engine(name: str) -> Engine:
    """The module of an engine."""
    return cast(Engine, import_module(f"{__name__}.{name}"))
