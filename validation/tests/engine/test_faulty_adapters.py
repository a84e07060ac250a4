"""Adapters with one fault each fail the tests of an engine that name it, and no others."""

import re
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from drivers.base import paths
from drivers.base.decks import Deck
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import Trace, make_trace
from drivers.engines import Engine, load_engine
from drivers.laws import VISCOELASTIC
from validation.tests.engine.candidate import MINE, STAND_INS
from validation.tests.engine.kit import Kit
from validation.tests.helpers.commands import beads, beads_process
from validation.tests.helpers.scenes import EnginesWriter

Change = Callable[[Engine], Engine]
RUN = ("start", "scene[damped]")  # both fail if the guard fails a run
QUICK = ("interface", "version", "deck")
DEPARTS = "departs from its scheme"
FOLDER = paths.ROOT / "validation" / "tests" / "engine"
FEW = "interface or version or base"


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
    tests = [str(FOLDER / f"test_{name}.py") for name in ("adapter", "output", "results")]
    with redirect_stdout(StringIO()):
        pytest.main(["-p", "no:cacheprovider", "--engine", "mine", "-n0", *tests], plugins=[recorder])
    return recorder.failures


def less_damped(case: Case) -> Case:
    law = case.chain.law
    if law.name != VISCOELASTIC:
        return case
    return replace(case, chain=replace(case.chain, law=replace(law, value=0.99 * law.value)))


def finer(case: Case) -> Case:
    return case.at(20 * case.scene.steps_per_sample) if case.scene.time_step_s > 5e-6 else case


def rendering(change: Callable[[Case], Case]) -> Change:
    """Decks of a changed case."""
    return lambda engine: replace(engine, render=lambda case: engine.render(change(case)))


def writing(change: Callable[[Case, str], str]) -> Change:
    """Decks of changed text."""

    def changed(case: Case, deck: Deck) -> Deck:
        return replace(deck, files={name: change(case, text) for name, text in deck.files.items()})

    return lambda engine: replace(engine, render=lambda case: changed(case, engine.render(case)))


def having(**fields: Any) -> Change:
    """Other values of the interface."""
    return lambda engine: replace(engine, **fields)


def half_a_step_ahead(engine: Engine) -> Engine:
    """Velocities half a step ahead, as in a leapfrog scheme."""

    def read(case: Case, folder: Path) -> Trace:
        """Read the trace."""
        trace = engine.read(case, folder)
        assert trace.height_m is not None
        assert trace.velocity_m_s is not None
        velocity = trace.velocity_m_s + 0.5 * case.scene.time_step_s * case.chain.load_N / case.chain.mass_kg
        return make_trace(case.chain, trace.time_s, trace.force_N, trace.height_m, velocity)

    return replace(engine, read=read)


def rounded(case: Case, text: str) -> str:
    """Numbers rounded to six digits."""
    return re.sub(r"[0-9]+\.[0-9]{6,}", lambda number: f"{float(number[0]):.6g}", text)


KEEPING = """
import json
import sys
from pathlib import Path
from validation.reference.__main__ import main
kept = {}
for line in sys.stdin:
    folder, word = line.rstrip("\\n").split(" ")
    if folder:
        path = Path(folder, "chain.json")
        kept |= json.loads(path.read_text())
        path.write_text(json.dumps(kept))
        main(path)
    print(word, flush=True)
"""
# fault: the change that makes a good adapter faulty, and a pattern of the message of each test that fails
FAULTS: dict[str, tuple[Change, dict[str, str]]] = {
    "wrong damping": (
        rendering(less_damped), dict.fromkeys(("scene[damped]", "restitution[two beads-0.3]"), DEPARTS),
    ),
    "a smaller step in place of a blow-up": (rendering(finer), {"blow_up": DEPARTS}),
    "velocities of another time": (half_a_step_ahead, dict.fromkeys(RUN, DEPARTS)),
    "numbers of its own": (
        having(read=lambda case, folder: verlet_of(case)),
        {"changed_decks": "striker speed", "damaged_output": "no raw output: read without"},
    ),
    "decks with the scene's name": (
        writing(lambda case, text: text.replace("SI units", case.scene.name)), {"deck": "scene.name"},
    ),
    "decks of six digits": (
        writing(rounded), {"deck": "is the same as for no change", **dict.fromkeys(RUN, DEPARTS)},
    ),
    "another command in the first line": (
        writing(lambda case, text: text.replace("-m validation", "-m another")),
        {"deck_by_hand": "the first line of chain.json is not its command"},
    ),
    "a server that keeps keys of earlier decks": (
        having(server=Deck({"serve.py": KEEPING}, ("python", "serve.py"), raw=())), {"server": "after another case: "},
    ),
    "an unknown scheme": (having(scheme="implicit"), {"interface": "assert 'implicit' in"}),
    "a constant version": (having(version=lambda command: "mine 3.8.0"), {"version": "true gives the same"}),
}  # fmt: skip
SLOW = ("changed_decks", "damaged_output", "deck_by_hand", "server")


@pytest.fixture
def mine(engines_file: EnginesWriter, tmp_path: Path) -> Iterator[Engine]:
    """Returns an adapter outside the tree that models straight chains only."""
    (tmp_path / "mine.py").write_text(MINE)
    engines_file(f'[mine]\nadapter = "mine.py"\ncommand = "{sys.executable}"\n')
    yield load_engine("mine")
    STAND_INS.clear()


@pytest.mark.parametrize(
    "fault",
    [pytest.param(name, marks=[pytest.mark.long] * any(map(red.get, SLOW))) for name, (_, red) in FAULTS.items()],
)
def test_a_faulty_adapter_fails_the_tests_that_name_its_fault(fault: str, mine: Engine) -> None:
    change, red = FAULTS[fault]
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


def test_engines_that_are_not_installed_are_named(engines_file: EnginesWriter, tmp_path: Path) -> None:
    (tmp_path / "absent.py").write_text(MINE)
    place = engines_file('[absent]\nadapter = "absent.py"\ncommand = "no-such-program"\nhow_to_get = "a search"\n')
    absent, unknown = beads("engine", "absent"), beads("engine", "unknown")
    message = f"error: absent: not installed; it comes with a search (looked for no-such-program of {place})\n"
    assert (absent.returncode, absent.stderr) == (1, message)
    assert unknown.returncode == 2
    assert unknown.stderr.startswith('engine: found "unknown"; allowed: absent, ')


def test_the_tests_of_an_engine_end_when_their_time_is_over_and_go_on_later() -> None:
    """A test that passed is left out the next time."""
    left = []
    for within_s in (0.0, 60.0):
        kit = Kit("verlet", within_s)
        with redirect_stdout(StringIO()):
            pytest.main(["-p", "no:cacheprovider", "--engine", "verlet", "-n0", str(FOLDER), "-k", FEW], plugins=[kit])
        left.append((bool(kit.over), kit.left, len(kit.passed), len(kit.before)))
    assert left == [(True, 2, 1, 0), (False, 0, 2, 1)]
