"""Engine under test with its build and its scenes, run in one folder."""

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
from drivers.base.processes import EndedProcess, run_command
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

NORMAL_END = EndedProcess(0, False, 0.0, wall_s=0.0, cpu_s=0.0, memory_bytes=0)


class NotRunError(Exception):
    """A check does not apply to the engine; the message is the reason."""


@dataclass(frozen=True)
class Measured:
    """Result of a check: a value and its limit; the check fails if the value exceeds the limit or is NaN.

    Attributes:
        words: description of the value.
    """

    value: float
    limit: float
    words: str

    @property
    def share(self) -> float:
        """Value over limit; inf for NaN."""
        share = self.value / self.limit if self.limit else (0.0 if self.value == 0 else np.inf)
        return float(share) if np.isfinite(share) else np.inf


def within(quantity: str, value: float, words: str) -> Measured:
    """Result of a check with a limit of ``inputs/tolerances.toml``."""
    return Measured(value, tolerance("kit", quantity).limit, words)


Settings = Annotated[tuple[str, ...], Field(strict=False)]


class Variant(Part):
    """A scene for every engine that does not refuse it; by default the kit's scene with settings."""

    name: str
    scene: str | None = None
    set: Settings = ()


class KitFile(Part):
    """``inputs/kit.toml``: the scene, settings without effect on numbers, settings with an effect, and variants."""

    scene: str
    set: Settings
    same: Settings
    change: dict[str, Settings]
    variant: tuple[Variant, ...] = Field(strict=False)


@cache
def kit_file() -> KitFile:
    """Read the file of the kit."""
    return validate(KitFile, read_toml(paths.KIT), paths.shown(paths.KIT))


def case_with(*settings: str) -> Case:
    """Planned case of the kit's scene with settings."""
    return planned_case(kit_file().scene, *kit_file().set, *settings)


@dataclass(frozen=True)
class Candidate:
    """An engine under test.

    Attributes:
        folder: temporary folder of the runs.
        session: server for the checks of physics; None if the check of the server failed.
    """

    engine: Engine
    build: Build
    folder: Path
    session: Session | None = None

    @property
    def steps(self) -> bool:
        """True if the engine has a time step."""
        return self.engine.scheme != EXACT

    @cached_property
    def base(self) -> Case:
        """Case of the kit's scene."""
        return case_with()

    @cached_property
    def deck(self) -> Deck:
        """Deck of the kit's scene."""
        return self.engine.render(self.base)

    @cached_property
    def alone(self) -> tuple[Path, Trace]:
        """Folder and trace of the kit's scene, run in a process of its own."""
        folder, outcome = self.process(self.deck, "alone")
        return folder, checked_trace(self.base, self.engine, outcome, folder)

    def process(self, deck: Deck, name: str, limit_s: float | None = None) -> tuple[Path, EndedProcess]:
        """Run a deck in a process and a folder of its own."""
        folder = self.folder / f"{name}-{sum(1 for _ in self.folder.iterdir())}"
        folder.mkdir()
        deck.write(folder)
        limit_s = limit_s or default_limit_s(self.base, self.engine)
        command = self.engine.started(deck, self.build.command)
        return folder, run_command(command, folder, limit_s, **self.engine.environment)

    def read(self, case: Case, folder: Path) -> Trace:
        """Trace of a folder, read as that of a successful run; RunError if it cannot be a trace of the case."""
        return checked_trace(case, self.engine, NORMAL_END, folder)

    def execute(self, case: Case, deck: Deck) -> tuple[Path, EndedProcess]:
        """Run a deck with the time limit of a case, on the server if there is one."""
        limit_s = default_limit_s(case, self.engine)
        if self.session is None:
            return self.process(deck, "run", limit_s)
        outcome = self.session.run(deck, limit_s)
        return self.session.case, outcome

    def run_deck(self, case: Case, deck: Deck) -> Trace:
        """Run a deck and read its trace as that of the case; RunError if it cannot be."""
        folder, outcome = self.execute(case, deck)
        return checked_trace(case, self.engine, outcome, folder)

    def run(self, case: Case) -> Trace:
        """Run a case and read its trace; RunError if the run fails.

        Raises:
            NotRunError: the engine refuses the case.
        """
        self.admit(case)
        return self.run_deck(case, self.engine.render(case))

    def admit(self, case: Case) -> None:
        """Raise NotRunError if the engine refuses the case."""
        if refused := inability(case, self.engine.name):
            raise NotRunError(f"refused: {str(refused).removeprefix(f'{refused.args[0]}: ')}")

    def changed(self) -> Mapping[str, Case]:
        """Cases of the kit's scene with each change that the engine models and that has to change its deck."""
        found = {name: case_with(*settings) for name, settings in kit_file().change.items()}
        return {
            name: case
            for name, case in found.items()
            if inability(case, self.engine.name) is None and (self.steps or name != "time step")
        }
