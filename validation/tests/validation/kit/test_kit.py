"""The kit passes every installed engine, and each of its checks fails an adapter with one fault."""

import re
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from drivers.base.decks import Deck
from drivers.base.errors import RunError
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import Trace
from drivers.engines import VERLET, Engine, engine_names, load_engine
from validation.compare.verdict import FAIL, NOT_RUN, PASS
from validation.kit.judge import CHECKS, SERVER, Row, judge
from validation.studies import read_table
from validation.tests.helpers.commands import command_line
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import EnginesWriter

SLOW = ("damaged output", "failures and time limit", SERVER)
RUN = ("start", "scene: base", "scene: damped", "order", "blow-up")  # all of these fail if the guard fails a run
QUICK_CHECKS = ("interface", "version and identity", "deck", *RUN)
MINE = '''"""An adapter outside the tree."""

from dataclasses import replace

from drivers.base.processes import line_of
from drivers.chain.elements import STRAIGHT
from drivers.engines import load_engine

ENGINE = replace(
    load_engine("verlet"),
    in_repository=False,
    version=lambda command: line_of(command, "--version", "Python"),
    models=STRAIGHT,
    style=None,
)
'''


def rows_of(engine: Engine, home: Path, names: Iterable[str] = tuple(CHECKS)) -> dict[str, Row]:
    return {row.check: row for row in judge(engine, home, names)}


ENGINES = [pytest.param(name, marks=() if name == VERLET else pytest.mark.long) for name in engine_names()]


@pytest.mark.parametrize("name", ENGINES)
@pytest.mark.parametrize("part", ["quick", pytest.param("slow", marks=pytest.mark.long)])
def test_every_engine_passes(name: str, part: str, shared_runs: Path) -> None:
    need(name)
    checks = SLOW if part == "slow" else [each for each in CHECKS if each not in SLOW]
    rows = rows_of(load_engine(name), shared_runs / name, checks)
    assert {check: row.words for check, row in rows.items() if row.verdict == FAIL} == {}
    reasons = [row.words for row in rows.values() if row.verdict == NOT_RUN]
    assert all(reason.startswith(("refused: ", "the engine has no time step")) for reason in reasons)


@pytest.fixture
def mine(engines_file: EnginesWriter, tmp_path: Path) -> Engine:
    """Returns an adapter outside the tree that models straight chains only."""
    (tmp_path / "mine.py").write_text(MINE)
    engines_file(f'[mine]\nadapter = "mine.py"\ncommand = "{sys.executable}"\n')
    return load_engine("mine")


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
# fault: the faulty adapter, made from a good one, and a pattern of the row of each check that fails
BROKEN: dict[str, tuple[Callable[[Engine], Engine], dict[str, str]]] = {
    "nothing": (lambda engine: engine, {}),
    "wrong stiffness": (partial(rendering, stiffer), dict.fromkeys(RUN, "starts with a force")),
    "wrong damping": (
        partial(rendering, less_damped),
        {"scene: damped": "against verlet", "order": "deviation from order 1", "restitution": "over the loss"},
    ),
    "a smaller step in place of a blow-up": (
        partial(rendering, finer),
        {"blow-up": "where verlet blows up, the run did not fail"},
    ),
    "time shifted": (partial(reading, late), dict.fromkeys(RUN, "starts with a force")),
    "velocities of another time": (partial(reading, half_a_step_ahead), dict.fromkeys(RUN, "starts with a velocity")),
    "decks with the scene's name": (
        partial(writing, lambda case, text: text.replace("SI units", case.scene.name)),
        {"deck": "^scene.name changes the deck$"},
    ),
    "decks with gauges": (
        partial(writing, lambda case, text: text.replace("SI units", str(case.layout.sensors))),
        {"deck": "^chain.sensors changes the deck$"},
    ),
    "decks of six digits": (
        partial(writing, rounded),
        {"deck": "is the same as for no change", **dict.fromkeys(RUN, "starts with a force")},
    ),
    "decks that hold a folder": (
        partial(writing, lambda case, text: text.replace("SI units", str(Path.cwd()))),
        {"deck": f"depends on the folder or on PATH; the deck contains {Path.cwd()}"},
    ),
    "another command in the first line": (
        partial(writing, lambda case, text: text.replace("-m validation", "-m another")),
        {"deck by hand": "the first line of chain.json is not its command"},
    ),
    "numbers of its own": (
        own_numbers,
        {
            "sabotage": "striker speed, .* changes the forces by no more",
            "damaged output": "^no raw output: read without",
        },
    ),
    "errors of its own": (careless, {"damaged output": "^no raw output: ValueError: no output"}),
    "output that it does not name": (
        lambda engine: replace(engine, render=lambda case: replace(engine.render(case), raw=("chain.out",))),
        {"damaged output": "^no raw output: read without an error"},
    ),
    "a server that does not repeat": (
        lambda engine: replace(engine, server=Deck({"serve.py": UNSTEADY}, ("python", "serve.py"), raw=())),
        {SERVER: "^first case: forces differ by"},
    ),
    "a server that keeps damping": (
        lambda engine: replace(engine, server=Deck({"serve.py": KEEPING}, ("python", "serve.py"), raw=())),
        {SERVER: "^after another case: .* energy is off", "order": "energy is off"},
    ),
    "gravity of its own": (
        partial(rendering, on_earth),
        {"scene: tenfold gravity": "against verlet|energy is off"},
    ),
    "a constant version": (
        lambda engine: replace(engine, version=lambda command: "mine 3.8.0"),
        {"version and identity": "true gives the same"},
    ),
    "no version": (
        lambda engine: replace(engine, version=lambda command: ""),
        {"version and identity": "^no version"},
    ),
    "no seconds of its loop": (
        lambda engine: replace(engine, loop_pattern="^never ([0-9])$"),
        {"cost": "no line of the output matches loop_pattern"},
    ),
    "a pattern without a group": (lambda engine: replace(engine, loop_pattern="x"), {"interface": "has no group"}),
    "an unknown scheme": (lambda engine: replace(engine, scheme="implicit"), {"interface": 'scheme is "implicit"'}),
}


FIRST = ("nothing", "wrong stiffness", "wrong damping", "time shifted", "numbers of its own", "gravity of its own")


@pytest.mark.parametrize(
    "fault", [pytest.param(each, marks=[] if each in FIRST else pytest.mark.long) for each in BROKEN]
)
def test_a_wrong_adapter_turns_its_check_red(fault: str, mine: Engine, tmp_path: Path) -> None:
    change, red = BROKEN[fault]
    rows = rows_of(change(mine), tmp_path / "runs", dict.fromkeys((*QUICK_CHECKS, *red)))
    failed = {check: row.words for check, row in rows.items() if row.verdict == FAIL}
    assert set(failed) == set(red), failed
    assert {check: words for check, words in failed.items() if not re.search(red[check], words)} == {}


@pytest.mark.long
def test_a_process_that_survives_the_time_limit_is_found(engines_file: EnginesWriter, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    script = tmp_path / "start.sh"
    script.write_text(f'#!/bin/sh\nsetsid sleep 15 &\nexec {sys.executable} "$@"\n')
    script.chmod(0o755)
    engines_file(f'[mine]\nadapter = "mine.py"\ncommand = "{script}"\n')
    row = rows_of(load_engine("mine"), tmp_path / "runs", ["failures and time limit"])["failures and time limit"]
    assert row.verdict == FAIL
    assert re.search("[0-9] processes continued after the time limit", row.words)


@pytest.mark.long
def test_an_adapter_outside_the_tree_passes_without_the_checks_of_elements_it_does_not_model(
    mine: Engine, tmp_path: Path
) -> None:
    words = ("validation", "engine", "mine", "--runs", tmp_path / "runs", "--results", tmp_path)
    done = command_line(*words)
    assert done.returncode == 0, done.stdout
    table = read_table(tmp_path / "engine-mine.csv", Row, "engine").set_index("check")
    assert set(table["verdict"]) == {PASS, NOT_RUN}
    excused = {each for each in CHECKS if "tube" in each or "axis" in each}
    assert set(table.index[table["verdict"] == NOT_RUN]) == excused
    assert len(table) == len(CHECKS)
    assert "refused: " in str(table.loc["scene: off the axis", "words"])
    *_, name, start, _, _, _, not_run, last = done.stdout.splitlines()
    assert (name, start.partition(" = ")[0]) == ("[mine]", "start_s")
    assert not_run.startswith("not run: the adapter refuses the scene")
    assert re.match(rf"{len(CHECKS)} checks in \d+ s: .* 0 fail, 4 not run; closest to its limit: ", last)


def test_engines_that_are_not_installed(engines_file: EnginesWriter, tmp_path: Path) -> None:
    (tmp_path / "absent.py").write_text(MINE)
    engines_file('[absent]\nadapter = "absent.py"\ncommand = "no-such-program"\nhow_to_get = "a search"\n')
    absent = command_line("validation", "engine", "absent", "--runs", tmp_path)
    assert absent.returncode == 1
    place = tmp_path / "own-engines.toml"
    message = f"error: absent: not installed; it comes with a search (looked for no-such-program of {place})\n"
    assert absent.stderr == message
    unknown = command_line("validation", "engine", "unknown")
    assert unknown.returncode == 2
    assert unknown.stderr.startswith('engine: found "unknown"; allowed: absent, ')
