"""Adapters with one fault each fail the tests of an engine that name it, and no others."""

import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from drivers.base import paths
from drivers.base.decks import Deck
from drivers.base.errors import RunError
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import Trace
from drivers.engines import Engine, load_engine
from validation.tests.engine.candidate import MINE, STAND_INS
from validation.tests.helpers.commands import command_line
from validation.tests.helpers.scenes import EnginesWriter

RUN = ("start", "scene[base]", "scene[damped]", "order[elastic]", "blow_up")  # all fail if the guard fails a run
QUICK = ("interface", "version", "deck", *RUN)


class Recorder:
    """Plugin of pytest that keeps the failures of a run: test, without the engine, and message."""

    def __init__(self) -> None:
        self.failures: dict[str, str] = {}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            name = report.nodeid.rpartition("::test_")[2]
            self.failures[re.sub(r"\[mine-?", "[", name).removesuffix("[]")] = report.longreprtext


def failures_of(names: tuple[str, ...]) -> dict[str, str]:
    """Failures of the named tests on the engine ``mine``."""
    recorder = Recorder()
    words = " or ".join(re.sub(r"\[|-", " and ", name.rstrip("]")) for name in names)
    options = ["-p", "no:cacheprovider", "-p", "no:terminal", "-p", "no:xdist", "--engine", "mine"]
    folder = paths.ROOT / "validation" / "tests" / "engine"
    tests = [str(folder / f"test_{name}.py") for name in ("adapter", "output", "results")]
    pytest.main([*options, *tests], plugins=[Selection(names), recorder])
    return recorder.failures


def stiffer(case: Case, factor: float = 1 + 1e-6) -> Case:
    return replace(case, chain=replace(case.chain, stiffness=factor * case.chain.stiffness))


def less_damped(case: Case) -> Case:
    return replace(case, chain=replace(case.chain, damping_ratio=0.99 * case.chain.damping_ratio))


def on_earth(case: Case) -> Case:
    gravity = case.chain.load_N / case.chain.mass_kg
    pressed = np.ptp(gravity) > 1e-9
    return (
        case if pressed else replace(case, chain=replace(case.chain, load_N=gravity.clip(-9.82) * case.chain.mass_kg))
    )


def finer(case: Case) -> Case:
    return case.at(20 * case.scene.steps_per_sample) if case.scene.time_step_s > 5e-6 else case


def rendering(change: Callable[[Case], Case], engine: Engine) -> Engine:
    """Engine with decks of a changed case."""

    def render(case: Case) -> Deck:
        """A deck."""
        return engine.render(change(case))

    return replace(engine, render=render)


def writing(change: Callable[[Case, str], str], engine: Engine) -> Engine:
    """Engine with decks of changed text."""

    def render(case: Case) -> Deck:
        """A deck."""
        deck = engine.render(case)
        return replace(deck, files={name: change(case, text) for name, text in deck.files.items()})

    return replace(engine, render=render)


def reading(change: Callable[[Case, Trace], Trace], engine: Engine) -> Engine:
    """Engine with changed traces."""
    return replace(engine, read=lambda case, folder: change(case, engine.read(case, folder)))


def late(case: Case, trace: Trace) -> Trace:
    """Forces stamped a sample early."""
    return replace(trace, force_N=np.vstack([trace.force_N[1:], trace.force_N[-1:]]))


def half_a_step_ahead(case: Case, trace: Trace) -> Trace:
    """Velocities half a step ahead, as in a leapfrog scheme."""
    assert trace.velocity_m_s is not None
    ahead = 0.5 * case.scene.time_step_s * case.chain.load_N / case.chain.mass_kg
    return replace(trace, velocity_m_s=trace.velocity_m_s + ahead)


def rounded(case: Case, text: str) -> str:
    """Numbers rounded to six digits."""
    return re.sub(r"[0-9]+\.[0-9]{6,}", lambda number: f"{float(number[0]):.6g}", text)


def own_numbers(engine: Engine) -> Engine:
    """Engine whose trace does not come from the output."""
    return replace(engine, read=lambda case, folder: verlet_of(case))


def careless(engine: Engine) -> Engine:
    """Engine that raises ValueError in place of RunError."""

    def read(case: Case, folder: Path) -> Trace:
        """The trace."""
        try:
            return engine.read(case, folder)
        except RunError as error:
            raise ValueError(str(error)) from error

    return replace(engine, read=read)


UNSTEADY = """
import sys
from pathlib import Path
import numpy as np
from validation.reference.__main__ import main
for place, line in enumerate(sys.stdin):
    folder, word = line.rstrip("\\n").split(" ")
    if folder:
        main(Path(folder, "chain.json"))
        np.save(Path(folder, "chain.npy"), np.load(Path(folder, "chain.npy")) * (1 + place * 1e-12))
    print(word, flush=True)
"""
KEEPING = """
import json
import sys
from pathlib import Path
from validation.reference.__main__ import main
key, kept = "damping_N_s_m-5/4", []
for line in sys.stdin:
    folder, word = line.rstrip("\\n").split(" ")
    if folder:
        path = Path(folder, "chain.json")
        deck = json.loads(path.read_text())
        if len(kept) == len(deck["mass_kg"]):
            deck.setdefault(key, kept)
            path.write_text(json.dumps(deck))
        kept = deck.get(key, [])
        main(path)
    print(word, flush=True)
"""
