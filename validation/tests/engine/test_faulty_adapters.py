"""Adapters with one fault each fail the tests of an engine that name it, and no others."""

import re
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from dataclasses import replace
from functools import partial
from io import StringIO
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
from drivers.laws.viscoelastic import Viscoelastic
from validation.tests.engine.candidate import MINE, STAND_INS
from validation.tests.helpers.commands import beads, beads_process
from validation.tests.helpers.scenes import EnginesWriter

RUN = ("start", "scene[base]", "scene[damped]", "order[elastic]", "blow_up")  # all fail if the guard fails a run
QUICK = ("interface", "version", "deck", *RUN)


class Recorder:
    """Plugin of pytest that selects tests of an engine by name, and keeps the failures."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self.names = names
        self.failures: dict[str, str] = {}

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [item for item in items if short_name(item.name) in self.names]

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failures[short_name(report.nodeid.rpartition("::")[2])] = report.longreprtext


def short_name(name: str) -> str:
    """Name of a test without its prefix and the engine: ``order[damped]`` for ``test_order[mine-damped]``."""
    return re.sub(r"\[mine-?", "[", name).removeprefix("test_").replace("[]", "")


def failures_of(names: tuple[str, ...]) -> dict[str, str]:
    """Failures of the named tests on the engine ``mine``."""
    recorder = Recorder(names)
    folder = paths.ROOT / "validation" / "tests" / "engine"
    tests = [str(folder / f"test_{name}.py") for name in ("adapter", "output", "results")]
    with redirect_stdout(StringIO()):
        pytest.main(["-p", "no:cacheprovider", "--engine", "mine", "-n0", *tests], plugins=[recorder])
    return recorder.failures


def stiffer(case: Case, factor: float = 1 + 1e-6) -> Case:
    return replace(case, chain=replace(case.chain, stiffness=factor * case.chain.stiffness))


def less_damped(case: Case) -> Case:
    law = case.chain.law
    if not isinstance(law, Viscoelastic):
        return case
    return replace(case, chain=replace(case.chain, law=replace(law, damping_ratio=0.99 * law.damping_ratio)))


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


# fault: the faulty adapter, made from a good one, and a pattern of the message of each test that fails
BROKEN: dict[str, tuple[Callable[[Engine], Engine], dict[str, str]]] = {
    "nothing": (lambda engine: engine, {}),
    "wrong stiffness": (partial(rendering, stiffer), dict.fromkeys(RUN, "starts with a force")),
    "wrong damping": (
        partial(rendering, less_damped),
        {
            "scene[damped]": "model: force",
            "restitution[two beads-0.3]": "assert",
            "restitution[two beads-0.8]": "assert",
        },
    ),
    "a smaller step in place of a blow-up": (
        partial(rendering, finer),
        {"blow_up": "DID NOT RAISE"},
    ),
    "time shifted": (partial(reading, late), dict.fromkeys(RUN, "starts with a force")),
    "velocities of another time": (partial(reading, half_a_step_ahead), dict.fromkeys(RUN, "starts with a velocity")),
    "decks with the scene's name": (
        partial(writing, lambda case, text: text.replace("SI units", case.scene.name)),
        {"deck": "scene.name"},
    ),
    "decks with gauges": (
        partial(writing, lambda case, text: text.replace("SI units", str(case.layout.sensors))),
        {"deck": "chain.sensors"},
    ),
    "decks of six digits": (
        partial(writing, rounded),
        {"deck": "is the same as for no change", **dict.fromkeys(RUN, "starts with a force")},
    ),
    "decks that hold a folder": (
        partial(writing, lambda case, text: text.replace("SI units", str(Path.cwd()))),
        {"deck": "the deck contains a folder"},
    ),
    "another command in the first line": (
        partial(writing, lambda case, text: text.replace("-m validation", "-m another")),
        {"deck_by_hand": "the first line of chain.json is not its command"},
    ),
    "numbers of its own": (
        own_numbers,
        {
            "changed_decks": "striker speed",
            "damaged_output": "no raw output: read without",
        },
    ),
    "errors of its own": (careless, {"damaged_output": "no raw output: ValueError: no output"}),
    "output that it does not name": (
        lambda engine: replace(engine, render=lambda case: replace(engine.render(case), raw=("chain.out",))),
        {"damaged_output": "no raw output: read without an error"},
    ),
    "a server that does not repeat": (
        lambda engine: replace(engine, server=Deck({"serve.py": UNSTEADY}, ("python", "serve.py"), raw=())),
        {"server": "first case: other forces"},
    ),
    "a server that keeps damping": (
        lambda engine: replace(engine, server=Deck({"serve.py": KEEPING}, ("python", "serve.py"), raw=())),
        {"server": "after another case: ", "order[elastic]": "energy"},
    ),
    "gravity of its own": (
        partial(rendering, on_earth),
        {"scene[tenfold-gravity]": "model: |energy"},
    ),
    "a constant version": (
        lambda engine: replace(engine, version=lambda command: "mine 3.8.0"),
        {"version": "true gives the same"},
    ),
    "no version": (
        lambda engine: replace(engine, version=lambda command: ""),
        {"version": "UNKNOWN_VERSION"},
    ),
    "no seconds of its loop": (
        lambda engine: replace(engine, loop_pattern="^never ([0-9])$"),
        {"server": "no line of the output matches loop_pattern"},
    ),
    "a pattern without a group": (lambda engine: replace(engine, loop_pattern="x"), {"interface": "has no group"}),
    "an unknown scheme": (lambda engine: replace(engine, scheme="implicit"), {"interface": "assert 'implicit' in"}),
}
FIRST = ("nothing", "wrong stiffness", "wrong damping", "time shifted", "numbers of its own", "gravity of its own")


@pytest.fixture
def mine(engines_file: EnginesWriter, tmp_path: Path) -> Iterator[Engine]:
    """Returns an adapter outside the tree that models straight chains only."""
    (tmp_path / "mine.py").write_text(MINE)
    engines_file(f'[mine]\nadapter = "mine.py"\ncommand = "{sys.executable}"\n')
    yield load_engine("mine")
    STAND_INS.clear()


@pytest.mark.parametrize(
    "fault", [pytest.param(name, marks=[] if name in FIRST else pytest.mark.long) for name in BROKEN]
)
def test_a_faulty_adapter_fails_the_tests_that_name_its_fault(fault: str, mine: Engine) -> None:
    change, red = BROKEN[fault]
    STAND_INS["mine"] = change(mine)
    failed = failures_of((*QUICK, *red))
    assert set(failed) == set(red), failed
    assert {name: text for name, text in failed.items() if not re.search(red[name], text)} == {}


@pytest.mark.long
def test_an_adapter_outside_the_tree_passes_on_the_command_line(mine: Engine, tmp_path: Path) -> None:
    done = beads_process("engine", "mine", "--results", tmp_path)
    assert done.returncode == 0, done.stdout
    assert (tmp_path / "engine-mine.xml").exists()
    assert "refused: " in done.stdout
    assert re.search(r"[45][0-9] passed, [1-9] skipped", done.stdout)


def test_engines_that_are_not_installed(engines_file: EnginesWriter, tmp_path: Path) -> None:
    (tmp_path / "absent.py").write_text(MINE)
    engines_file('[absent]\nadapter = "absent.py"\ncommand = "no-such-program"\nhow_to_get = "a search"\n')
    absent = beads("engine", "absent")
    assert absent.returncode == 1
    place = tmp_path / "own-engines.toml"
    message = f"error: absent: not installed; it comes with a search (looked for no-such-program of {place})\n"
    assert absent.stderr == message
    unknown = beads("engine", "unknown")
    assert unknown.returncode == 2
    assert unknown.stderr.startswith('engine: found "unknown"; allowed: absent, ')
