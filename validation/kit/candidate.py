"""Engine under test: its build, its scenes, and the ways to run them, all in one folder."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from drivers.base import paths
from drivers.base.decks import Deck
from drivers.base.messages import validate
from drivers.base.processes import Outcome, run_command
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.trace import Trace
from drivers.engines import EXACT, Engine
from drivers.limits.refusal import inability
from drivers.run.build import Build
from drivers.run.guard import checked_trace
from drivers.run.run import default_limit_s
from drivers.run.session import Session
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml
from validation.accuracy.plan import planned_case

ENDED = Outcome(0, False, 0.0, wall_s=0.0, cpu_s=0.0, memory_bytes=0)


class NotRunError(Exception):
    """A check has no meaning for the engine; the message says why."""


@dataclass(frozen=True)
class Measured:
    """A number that a check holds against a limit; the check fails where it is beyond, or no number.

    Attributes:
        words: what it is, and against what.
    """

    value: float
    limit: float
    words: str

    @property
    def share(self) -> float:
        """The number over its limit; inf where it is none."""
        share = self.value / self.limit if self.limit else (0.0 if self.value == 0 else np.inf)
        return float(share) if np.isfinite(share) else np.inf


def within(quantity: str, value: float, words: str) -> Measured:
    """A number held against a limit of ``inputs/tolerances.toml``."""
    return Measured(value, tolerance("kit", quantity).limit, words)


Settings = Annotated[tuple[str, ...], Field(strict=False)]


class Variant(Part):
    """A scene that every engine runs, unless it refuses it by name; without one of its own the kit's."""

    name: str
    scene: str | None = None
    set: Settings = ()


class KitFile(Part):
    """``inputs/kit.toml``: the scene, settings that change no number, those that do, and variants."""

    scene: str
    set: Settings
    same: Settings
    change: dict[str, Settings]
    variant: tuple[Variant, ...] = Field(strict=False)


@cache
def kit_file() -> KitFile:
    """Scenes of the kit."""
    return validate(KitFile, read_toml(paths.KIT), paths.shown(paths.KIT))


def case_with(*settings: str) -> Case:
    """The kit's scene with settings."""
    return planned_case(kit_file().scene, *kit_file().set, *settings)


@dataclass(frozen=True)
class Candidate:
    """An engine under test.

    Attributes:
        folder: in which it runs; gone afterwards.
        session: its server for the checks of physics; None where it cannot be relied upon.
    """

    engine: Engine
    build: Build
    folder: Path
    session: Session | None = None

    @property
    def steps(self) -> bool:
        """Whether it has a time step."""
        return self.engine.scheme != EXACT

    @cached_property
    def base(self) -> Case:
        """The kit's scene."""
        return case_with()

    @cached_property
    def deck(self) -> Deck:
        """Its deck."""
        return self.engine.render(self.base)

    @cached_property
    def alone(self) -> tuple[Path, Trace]:
        """Folder and trace of its run in a process of its own."""
        folder, outcome = self.process(self.deck, "alone")
        return folder, checked_trace(self.base, self.engine, outcome, folder)

    def process(self, deck: Deck, name: str, limit_s: float | None = None) -> tuple[Path, Outcome]:
        """Runs a deck in a process and a folder of its own."""
        folder = self.folder / f"{name}-{sum(1 for _ in self.folder.iterdir())}"
        folder.mkdir()
        deck.write(folder)
        limit_s = limit_s or default_limit_s(self.base, self.engine)
        command = self.engine.started(deck, self.build.command)
        return folder, run_command(command, folder, limit_s, **self.engine.environment)

    def read(self, case: Case, folder: Path) -> Trace:
        """The trace of a folder whose run is said to have ended well; RunError where it cannot be one of the case."""
        return checked_trace(case, self.engine, ENDED, folder)

    def execute(self, case: Case, deck: Deck) -> tuple[Path, Outcome]:
        """Runs a deck within the time of a case, by the session where there is one."""
        limit_s = default_limit_s(case, self.engine)
        if self.session is None:
            return self.process(deck, "run", limit_s)
        outcome = self.session.run(deck, limit_s)
        return self.session.case, outcome

    def run_deck(self, case: Case, deck: Deck) -> Trace:
        """The trace of a deck as if it were that of the case; RunError where it cannot be."""
        folder, outcome = self.execute(case, deck)
        return checked_trace(case, self.engine, outcome, folder)

    def run(self, case: Case) -> Trace:
        """The trace of a case; RunError where it failed.

        Raises:
            NotRunError: the engine refuses the case.
        """
        self.admit(case)
        return self.run_deck(case, self.engine.render(case))

    def admit(self, case: Case) -> None:
        """Raises NotRunError where the engine refuses the case by name."""
        if refused := inability(case, self.engine.name):
            _, key, found, allowed = refused.args
            raise NotRunError(f"refused: {f'{key}: ' if key else ''}{found}; allowed: {allowed}")

    def changed(self) -> Mapping[str, Case]:
        """The kit's scene with each of the changes that the engine can take and that its deck has to show."""
        found = {name: case_with(*settings) for name, settings in kit_file().change.items()}
        return {
            name: case
            for name, case in found.items()
            if inability(case, self.engine.name) is None and (self.steps or name != "time step")
        }
