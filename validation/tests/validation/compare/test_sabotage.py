"""Decks with one fault on the real engines: each run fails or its model is red, and its law names the fault."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

from drivers.chain.case import Case
from drivers.engines import load_engine
from drivers.run.compute import compute
from validation.accuracy.budget import budget_of, first_departure
from validation.checks import FAIL
from validation.compare.law_sentence import law_sentence
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import SceneWriter, StandIn, case_of

MODEL = "model: force"  # the run is done, and this check is red
UNSTABLE = "^unstable at t = "
BALLS = (
    r"contact 1 \(ptfe with brass\) {} times as stiff; all contacts of ptfe with ptfe {} times as stiff, as with {}$"
)
WALL = r"contact 1 \(ptfe with brass\) {}$"
SENSOR = "chain.sensors=[{from_wall=3, mass='0.116 g'}]"
SCENES = {
    "struck": ("fig4", "chain.count=5", SENSOR, "striker.speed=1 m/s", "run.duration=0.3 ms"),
    "driven": ("driven-steel", "run.duration=0.3 ms"),
}


class Sabotage(NamedTuple):
    """A deck with one fault.

    Attributes:
        fault: name of the fault.
        good, bad: pattern in the deck's files and its replacement.
        red: the check that is red, or a pattern of the reason why the run fails.
        named: pattern of the sentence on the measured law; empty if there is too little to measure one.
        scene: name in ``SCENES``.
    """

    engine: str
    fault: str
    good: str
    bad: str
    red: str
    named: str = ""
    scene: str = "struck"


SABOTAGE = [
    # contacts and materials
    Sabotage("yade", "the default wall law", r"Ig2_Wall_Sphere_ScGeom\(hertzian=True\)", "Ig2_Wall_Sphere_ScGeom()",
             "force below", WALL.format(r"0\.707107 times as stiff, as with YADE's default law of a wall")),
    Sabotage("liggghts", "a wall of the beads' material", "type 2 zplane", "type 1 zplane",
             "force below", WALL.format(r"0\.507293 times as stiff, as with ptfe in place of brass")),
    Sabotage("liggghts", "beads of steel", r" 1460000000 (.*\n.*) 0\.46 ", r" 203000000000 \1 0.30 ",
             "force below", BALLS.format(r"44\.330654", r"120\.461538", "steel in place of ptfe")),
    Sabotage("yade", "all Poisson's ratios forgotten", " poisson=[^,]+,", "", "force below",
             BALLS.format(r"0\.842529", r"0\.84096", "YADE's default Poisson's ratio of 0.25 of all materials")),
    Sabotage("yade", "a Young's modulus forgotten", r'(label="ptfe",) young=[^,]+, poisson=[^,]+,', r"\1",
             "force below", BALLS.format(
                 r"0\.579532", r"0\.576", "YADE's default Young's modulus of 1 GPa and Poisson's ratio of 0.25 of ptfe"
             )),
    # dissipation
    Sabotage("yade", "the default damping", "damping=0, ", "",
             "velocity of", r"non-viscous damping of 0\.2, the default of YADE$"),
    Sabotage("lammps", "viscous damping", r"0 (tangential linear_nohistory 0 0) damping velocity",
             r"0.9 \1 damping tsuji limit_damping",
             "the energy is off", r"6 contacts have a damping ratio of 0\.021596, the scene has none$"),
    # masses, loads, start
    Sabotage("liggghts", "a sensor's mass", r"\n3 1 0.00476 2054\.\d+", r"\n3 1 0.00476 2171.0558198513872",
             "^", r"bead 3 \(sensor\) has 1\.057 of its mass$"),
    Sabotage("liggghts", "gravity forgotten", "fix weight.*\n", "", "^", "no gravity$"),
    Sabotage("lammps", "a little force", "fix motion", "fix push all addforce 0 0 -1e-3\nfix motion",
             "force below of 0.005746 N, the scene has 0.004746"),
    Sabotage("liggghts", "a striker at rest", "6 0 0 -1 0 0 0", "6 0 0 0 0 0 0",
             "starts with a velocity of 0 m/s", "the striker starts at rest$"),
    Sabotage("yade", "a slower strike", r"\(0, 0, velocity\)", "(0, 0, 0.9 * velocity)",
             r"velocity of -0\.9", r"the striker starts with 0\.9 of its speed$"),
    Sabotage("liggghts", "velocities half a step off", "6 0 0 -1 0 0 0", "6 0 0 -0.9999995095 0 0 0",
             "velocity of", "the striker starts with its velocity half a step behind$"),
    Sabotage("yade", "velocities half a step off", r"-0\.9999995095", "-1",
             "velocity of", "the striker starts with its velocity half a step ahead$"),
    # clock
    Sabotage("liggghts", "forces one step early", "dump samples all", "run 1\nreset_timestep 0\ndump samples all",
             "height of", r"all samples are stamped one step \(0\.1 µs\) early$"),
    Sabotage("yade", "forces one step late", "every if sample", "every - (sample == 1) if sample",
             MODEL, r"samples after the first are stamped one step \(0\.1 µs\) late$"),
    Sabotage("yade", "a step left out of each sample", "range.every if", "range(9 if", MODEL, ""),
    Sabotage("lammps", "a larger time step", r"timestep +\S+", "timestep 1.1e-07", MODEL,
             r"a time step 1\.1 times the scene's, with the scene's time stamps$"),
    Sabotage("liggghts", "half the time step", r"timestep +\S+", "timestep 0.05e-6", MODEL,
             r"a time step 0\.5 times the scene's, with the scene's time stamps$"),
    Sabotage("yade", "half the time step", "O.dt = time_step", "O.dt = time_step / 2",
             "height of", r"a time step 0\.5 times the scene's, with the scene's time stamps$"),
    # drives
    Sabotage("lammps", "another frequency", "50265.48", "50768.13", "the energy is off", scene="driven"),
    Sabotage("liggghts", "no drive", "fix drive .*\n", "\n", MODEL, scene="driven"),
    Sabotage("liggghts", "a drive of another bead", "driven id 20", "driven id 19", "the energy is off",
             scene="driven"),
    Sabotage("yade", "a drive one step late", "tau = step ", "tau = (step + 1) ", "the energy is off", scene="driven"),
    # ends
    Sabotage("lammps", "NaN", "timestep        1e-07", "timestep        1e200", "simulation unstable"),
    Sabotage("lammps", "a step far too large", "timestep        1e-07", "timestep        2.5e-05", UNSTABLE),
    Sabotage("liggghts", "no wall at 0", "zplane 0", "zplane -1", "starts with a force below of 0 N"),
    Sabotage("lammps", "a lost bead", "fix motion", "fix push all addforce 1000 0 0\nfix motion",
             f"{UNSTABLE}.*Lost atoms"),
    Sabotage("liggghts", "half way", "run             3000", "run             1500", "ends in sample 152 of 301"),
    Sabotage("yade", "half way", r"np.savez\(", "force = force[:150]\nnp.savez(", r"shape \(150, 6\)"),
    Sabotage("lammps", "an error in the deck", "pair_style      gran", "pair_style      grain", "pair style"),
    Sabotage("yade", "an error in the deck", "O.dt = time_step", "O.dt = steptime", "name 'steptime' is not defined"),
    Sabotage("yade", "death before the end", r"start = time.perf_counter\(\)", "import os; os._exit(0)",
             "was not written"),
    Sabotage("yade", "no closing line", r'print\(f"completed', 'str(f"completed', "did not run to its end"),
]  # fmt: skip


@cache
def case_called(scene: str) -> Case:
    """Case of a scene, which is read once."""
    return case_of(*SCENES[scene])


@pytest.mark.parametrize("row", [pytest.param(row, id=f"{row.engine}: {row.fault}") for row in SABOTAGE])
def test_a_sabotaged_deck_is_red_and_its_fault_is_named(row: Sabotage) -> None:
    need(row.engine)
    case = case_called(row.scene)
    deck = load_engine(row.engine).render(case)
    damaged = {name: re.sub(row.good, row.bad, text) for name, text in deck.files.items()}
    assert damaged != deck.files, "the pattern is not in the deck"
    ended = compute(case, row.engine, deck=replace(deck, files=damaged))
    if row.red == MODEL:
        budget = budget_of(case, row.engine, ended.done)
        assert MODEL in {check.quantity for check in budget.checks if check.verdict == FAIL}
        assert any("the engine did not run the scene as written" in warning for warning in budget.warnings)
    else:
        assert ended.fault is not None
        assert re.search(row.red, str(ended.fault)), ended.fault
    if row.named:
        trace = ended.trace if ended.fault is None else ended.fault.partial
        assert trace is not None
        assert first_departure(case, row.engine, trace)
        sentence = law_sentence(case, row.engine, trace)
        assert re.match(row.named, sentence), sentence


def test_the_comparison_prints_departure_and_law(stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path) -> None:
    """A build that forgets gravity fails, and its refused trace is kept to see the fault."""
    need("liggghts")
    found = load_engine("liggghts").find()
    assert found is not None
    stand_in("liggghts", f'[ ! -e chain.in ] || sed -i "/^fix weight/d" chain.in\nexec {found[0]} "$@"\n')
    words = ("--runs", tmp_path / "runs", "--engine", "liggghts")
    done = beads("compare", scene_file(top='gravity = "9.81 m/s^2"'), *words)
    assert done.returncode == 1, done.stderr
    assert re.search(
        r"^scene +liggghts +departs from its scheme from the start: the force in contact 6 ", done.stdout, re.MULTILINE
    ), done.stdout
    assert re.search(r"^scene +liggghts +no gravity$", done.stdout, re.MULTILINE), done.stdout
    kept = {path.name for path in (tmp_path / "runs" / "liggghts").glob("scene-*/*")}
    assert kept == {"chain.in", "chain.data", "run.json", "stdout.txt", "stderr.txt", "forces.parquet", "state.parquet"}
