"""Engine under test: its build, its scenes, and runs in temporary folders."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import pytest

from drivers.base import paths
from drivers.base.decks import Deck
from drivers.base.processes import EndedProcess, run_command
from drivers.chain.case import Case
from drivers.chain.schemes import default_limit_s
from drivers.chain.trace import Trace
from drivers.engines import EXACT, Engine
from drivers.limits import inability
from drivers.run.build import Build
from drivers.run.compute import Session
from drivers.run.scheme import checked_trace
from validation.accuracy.plan import planned_case

NORMAL_END = EndedProcess(0, False, 0.0)
STAND_INS: dict[str, Engine] = {}  # engines with a fault, by name, in tests of these tests

MINE = '''"""An adapter outside the tree."""

from dataclasses import replace

from drivers.base.processes import line_of
from drivers.chain.case import STRAIGHT
from drivers.engines import load_engine

ENGINE = replace(
    load_engine("verlet"),
    version=lambda command: line_of(command, "--version", "Python"),
    models=STRAIGHT,
    style={},
)
'''


@cache
def kit() -> dict[str, Any]:
    """Contents of ``inputs/kit.toml``."""
    return tomllib.loads((paths.INPUTS / "kit.toml").read_text())


def case_with(*settings: str) -> Case:
    """Planned case of the kit's scene with settings."""
    return planned_case(kit()["scene"], *kit()["set"], *settings)


def case_of_variant(variant: Mapping[str, Any]) -> Case:
    """Planned case of a variant of the kit."""
    settings = variant.get("set", ())
    return planned_case(variant["scene"], *settings) if "scene" in variant else case_with(*settings)


@dataclass(frozen=True)
class Candidate:
    """An engine under test.

    Attributes:
        folder: temporary folder of the runs.
        session: server that runs cases one after another.
    """

    engine: Engine
    build: Build
    folder: Path
    session: Session

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
        limit_s = limit_s or default_limit_s(self.base)
        command = self.engine.started(deck, self.build.command)
        return folder, run_command(command, folder, limit_s, **self.engine.environment)

    def read(self, case: Case, folder: Path) -> Trace:
        """Trace of a folder, read as that of a successful run; RunError if it cannot be a trace of the case."""
        return checked_trace(case, self.engine, NORMAL_END, folder)

    def execute(self, case: Case, deck: Deck) -> tuple[Path, EndedProcess]:
        """Run a deck on the server, with the time limit of a case."""
        outcome = self.session.run(deck, default_limit_s(case))
        return self.session.case, outcome

    def run_deck(self, case: Case, deck: Deck) -> Trace:
        """Run a deck and read its trace as that of the case; RunError if it cannot be."""
        folder, outcome = self.execute(case, deck)
        return checked_trace(case, self.engine, outcome, folder)

    def run(self, case: Case) -> Trace:
        """Run a case and read its trace; skip the test if the engine refuses the case. RunError if the run fails."""
        if refused := inability(case, self.engine.name):
            pytest.skip(f"refused: {str(refused).removeprefix(f'{refused.args[0]}: ')}")
        return self.run_deck(case, self.engine.render(case))

    def changed(self) -> Mapping[str, Case]:
        """Cases of the kit's scene with each change that the engine models and that has to change its deck."""
        cases = {name: case_with(*settings) for name, settings in kit()["change"].items()}
        return {
            name: case
            for name, case in cases.items()
            if inability(case, self.engine.name) is None and (self.steps or name != "time step")
        }
