"""Decks of the real engines with one fault: each run fails or is red, and its measured law names the fault."""

import re
import shutil
import sys
from pathlib import Path

import pytest

from drivers.engines import load_engine
from validation.checks import FAIL
from validation.compare.comparison import REFUSED
from validation.compare.selection import EngineSelection
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import failing_run, finished, need, run_and_compare
from validation.tests.helpers.scenes import SceneWriter, StandIn, case_of

DECK, YADE, DATA = "chain.in", "chain.py", "chain.data"
SENSOR = 'sensors = [{ from_wall = 3, mass = "0.116 g" }]'
GRAVITY = 'gravity = "9.81 m/s^2"'
UNSTABLE = "^unstable at t = "
PAIRS = (
    r"contact 1 \(ptfe with brass\) {} times as stiff; all contacts of ptfe with ptfe {} times as stiff, as with {}$"
)
LAW = "model"  # the run is done, and its model is red

# engine, fault: file, pattern, replacement, reason of the failed run (or LAW), sentence on the measured law
FAULTS = {
    ("yade", "the default wall law"): (
        YADE, r"Ig2_Wall_Sphere_ScGeom\(hertzian=True\)", "Ig2_Wall_Sphere_ScGeom()", "force below",
        r"contact 1 \(ptfe with brass\) 0\.707107 times as stiff, as with YADE's default law of a wall$",
    ),
    ("yade", "the default damping"): (
        YADE, "damping=0, ", "", "velocity of", r"non-viscous damping of 0\.2, the default of YADE$",
    ),
    ("yade", "some damping"): (
        YADE, "damping=0", "damping=0.03", "velocity of", r"non-viscous damping of 0\.03$",
    ),
    ("lammps", "a wall contact too stiff"): (
        DECK, r"(wall/gran granular hertz) \S+", r"\1 4867280554.542816", "force below",
        r"contact 1 \(ptfe with brass\) 2 times as stiff$",
    ),
    ("lammps", "the viscous damping"): (
        DECK, r"0 (tangential linear_nohistory 0 0) damping velocity", r"0.9 \1 damping tsuji limit_damping",
        "the energy is off", r"6 contacts have a damping ratio of 0\.021596, the scene has none$",
    ),
    ("lammps", "gravity forgotten"): (DECK, "fix weight.*\n", "", "", "no gravity$"),
    ("liggghts", "the viscous damping"): (
        DECK, r"(coefficientRestitution peratomtypepair 2) 1 1 1 1", r"\1 0.9 0.9 0.9 0.9", "the energy is off",
        r"6 contacts have a damping ratio of 0\.030598, the scene has none$",
    ),
    ("liggghts", "a sensor's mass"): (
        DATA, r"\n3 1 0.00476 2054\.\d+", r"\n3 1 0.00476 2171.0558198513872", "",
        r"bead 3 \(sensor\) has 1\.057 of its mass$",
    ),
    ("yade", "a sensor's mass"): (
        YADE, "0.000116", "0.00011", "", r"bead 3 \(sensor\) has 0\.948 of its mass$",
    ),
    ("liggghts", "velocities half a step off"): (
        DATA, r"6 0 0 -1 0 0 0", "6 0 0 -0.9999995095 0 0 0", "velocity of",
        "the striker starts with its velocity half a step behind$",
    ),
    ("yade", "velocities half a step off"): (
        YADE, r"-0\.9999995095", "-1", "velocity of", "the striker starts with its velocity half a step ahead$",
    ),
    ("liggghts", "forces stamped one step early"): (
        DECK, "dump samples all", "run 1\nreset_timestep 0\ndump samples all", "height of",
        r"all samples are stamped one step \(0\.1 µs\) early$",
    ),
    ("yade", "forces stamped one step early"): (
        YADE, "if sample else 1", "if sample else 2", "height of",
        r"all samples are stamped one step \(0\.1 µs\) early$",
    ),
    ("yade", "forces stamped one step late"): (
        YADE, "every if sample", "every - (sample == 1) if sample", LAW,
        r"samples after the first are stamped one step \(0\.1 µs\) late$",
    ),
    ("liggghts", "a striker without its speed"): (
        DATA, "6 0 0 -1 0 0 0", "6 0 0 0 0 0 0", "starts with a velocity of 0 m/s", "the striker starts at rest$",
    ),
    ("yade", "a striker without its speed"): (
        YADE, r"-0\.9999995095", "0", "velocity of", "the striker starts at rest$",
    ),
    ("yade", "a slower strike"): (
        YADE, r"\(0, 0, velocity\)", "(0, 0, 0.9 * velocity)", r"velocity of -0\.9",
        r"the striker starts with 0\.9 of its speed$",
    ),
    ("liggghts", "gravity forgotten"): (DECK, "fix weight.*\n", "", "", "no gravity$"),
    ("yade", "gravity forgotten"): (YADE, r", gravity=\(0, 0, -g\)", "", "", "no gravity$"),
    ("liggghts", "beads of steel"): (
        DECK, r" 1460000000 (.*\n.*) 0\.46 ", r" 203000000000 \1 0.30 ", "force below",
        PAIRS.format(r"44\.330654", r"120\.461538", "steel in place of ptfe"),
    ),
    ("yade", "beads of steel"): (
        YADE, r"young=1460000000, poisson=0\.46", "young=203e9, poisson=0.3", "force below",
        PAIRS.format(r"44\.330654", r"120\.461538", "steel in place of ptfe"),
    ),
    ("liggghts", "a wall of the beads' material"): (
        DECK, "type 2 zplane", "type 1 zplane", "force below",
        r"contact 1 \(ptfe with brass\) 0\.507293 times as stiff, as with ptfe in place of brass$",
    ),
    ("yade", "a wall of the beads' material"): (
        YADE, r'sense=1, material="brass"', 'sense=1, material="ptfe"', "force below",
        r"contact 1 \(ptfe with brass\) 0\.507293 times as stiff, as with ptfe in place of brass$",
    ),
    ("yade", "all Poisson's ratios forgotten"): (
        YADE, " poisson=[^,]+,", "", "force below",
        PAIRS.format(r"0\.842529", r"0\.84096", "YADE's default Poisson's ratio of 0.25 of all materials"),
    ),
    ("yade", "a Poisson's ratio forgotten"): (
        YADE, r'(label="ptfe", young=[^,]+,) poisson=[^,]+,', r"\1", "force below",
        PAIRS.format(r"0\.842887", r"0\.84096", "YADE's default Poisson's ratio of 0.25 of ptfe"),
    ),
    ("yade", "all Young's moduli forgotten"): (
        YADE, " young=[^,]+,", "", "force below",
        PAIRS.format(r"0\.323393", r"0\.684932", "YADE's default Young's modulus of 1 GPa of all materials"),
    ),
    ("yade", "a material without elastic constants"): (
        YADE, r'(label="ptfe",) young=[^,]+, poisson=[^,]+,', r"\1", "force below",
        PAIRS.format(
            r"0\.579532", r"0\.576", "YADE's default Young's modulus of 1 GPa and Poisson's ratio of 0.25 of ptfe"
        ),
    ),
    ("yade", "half the time step"): (
        YADE, "O.dt = time_step", "O.dt = time_step / 2", "height of",
        r"a time step 0\.5 times the scene's, with the scene's time stamps$",
    ),
    ("yade", "half the time step, twice the steps"): (
        YADE, "O.dt = time_step", "O.dt = time_step / 2; every *= 2", "height of",
        r"a time step 0\.5 times the scene's$",
    ),
    ("liggghts", "half the time step"): (
        DECK, r"timestep +\S+", "timestep 0.05e-6", LAW,
        r"a time step 0\.5 times the scene's, with the scene's time stamps$",
    ),
}  # fmt: skip
QUICK = [
    ("yade", "all Poisson's ratios forgotten"),
    ("yade", "half the time step"),
    ("yade", "the default wall law"),
    ("yade", "forces stamped one step late"),
    ("yade", "velocities half a step off"),
    ("liggghts", "the viscous damping"),
    ("liggghts", "a sensor's mass"),
    ("liggghts", "gravity forgotten"),
]
OF_THE_FAMILY = {
    "NaN": (DECK, "timestep        1e-07", "timestep        1e200", UNSTABLE),
    "half way": (DECK, "run             3000", "run             1500", "output ends in sample 152 of 301"),
    "a little force": (DECK, "fix motion", "fix push all addforce 0 0 -1e-3\nfix motion", "force below of 0.001 N"),
    "a lost bead": (DECK, "fix motion", "fix push all addforce 1000 0 0\nfix motion", f"{UNSTABLE}.*Lost atoms"),
    "an error in the deck": (DECK, "pair_style      gran", "pair_style      grain", "pair style"),
    "a step far too large": (DECK, "timestep        1e-07", "timestep        2.5e-05", UNSTABLE),
    "no wall at 0": (DECK, "zplane 0", "zplane -1", UNSTABLE),
}
# engine, fault: file, pattern, replacement, reason of the failed run, which leaves too little to measure a law
FAILED = {("lammps", fault): change for fault, change in OF_THE_FAMILY.items()} | {
    ("liggghts", fault): change for fault, change in OF_THE_FAMILY.items()
} | {
    ("yade", "NaN"): (YADE, "O.dt = time_step", "O.dt = float('nan')", f"{UNSTABLE}.*values are not finite"),
    ("yade", "an error in the deck"): (YADE, "O.dt = time_step", "O.dt = steptime", "name 'steptime' is not defined"),
    ("yade", "half way"): (YADE, r"np.savez\(", "force = force[:150]\nnp.savez(", r"shape \(150, 6\)"),
    ("yade", "death before the end"): (
        YADE, r"start = time.perf_counter\(\)", "import os; os._exit(0)", "chain.npz was not written",
    ),
    ("yade", "no closing line"): (YADE, r'print\(f"completed', 'str(f"completed', "did not run to its end"),
    ("yade", "a step far too large"): (YADE, "O.dt = time_step", "O.dt = 2.5e-5", UNSTABLE),
    ("yade", "no wall at 0"): (YADE, r"wall\(0", "wall(-1", UNSTABLE),
}  # fmt: skip


@pytest.mark.parametrize(
    ("engine", "fault"), [pytest.param(*key, marks=() if key in QUICK else pytest.mark.long) for key in FAULTS]
)
def test_a_sabotaged_deck_is_red_and_named(
    engine: str, fault: str, stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path, shared_runs: Path
) -> None:
    file, good, bad, reason, sentence = FAULTS[engine, fault]
    scene = scene_file(top=GRAVITY, chain=SENSOR)
    for name in ("reference", "verlet"):  # the same for every deck
        run = finished(case_of(scene), name, shared_runs).folder
        shutil.copytree(run, tmp_path / "runs" / name / run.name)
    swap(engine, file, good, bad, stand_in, tmp_path)
    compared = run_and_compare(scene, runs=tmp_path / "runs", asked=EngineSelection((engine,)))
    assert not any(why.startswith(REFUSED) for why in compared.absent.values())
    red = [check.quantity for check in compared.of_engine(engine) if check.verdict == FAIL]
    if reason == LAW:
        assert "model: force" in red
    else:
        assert red == ["run"]
        assert re.search(reason, compared.absent[engine]), compared.absent[engine]
    assert compared.departures[engine].startswith("departs from its scheme ")
    assert set(compared.diagnoses) == {engine}
    assert re.match(sentence, compared.diagnoses[engine]), compared.diagnoses[engine]


@pytest.mark.parametrize(
    ("engine", "fault"), [pytest.param(*key, marks=pytest.mark.long if key[0] == "yade" else ()) for key in FAILED]
)
def test_a_sabotaged_deck_that_stops_or_blows_up_fails_with_the_reason(
    engine: str, fault: str, stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path
) -> None:
    file, good, bad, reason = FAILED[engine, fault]
    swap(engine, file, good, bad, stand_in, tmp_path)
    status, found = failing_run(scene_file(), engine, tmp_path / "runs")
    assert status == "failed"
    assert re.search(reason, found), found


@pytest.mark.parametrize(
    ("engine", "file", "good", "bad"),
    [
        ("lammps", DECK, "1e-07", "1.1e-07"),
        ("liggghts", DECK, "1e-07", "1.1e-07"),
        ("yade", YADE, "range.every if", "range(9 if"),
    ],
)
def test_a_run_at_another_step_has_a_warning(
    engine: str, file: str, good: str, bad: str, stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path
) -> None:
    swap(engine, file, good, bad, stand_in, tmp_path)
    warnings = finished(case_of(scene_file()), engine, tmp_path / "runs").record.warnings
    assert warnings is not None
    assert "the engine did not run the scene as written" in warnings[-1]


@pytest.mark.long
def test_the_comparison_prints_departure_and_law(stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path) -> None:
    swap("yade", YADE, "damping=0, ", "", stand_in, tmp_path)
    done = beads("compare", scene_file(top=GRAVITY), "--runs", tmp_path / "runs")
    assert done.returncode == 1, done.stderr
    assert re.search(r"^scene +yade +departs from its scheme from 1 µs", done.stdout, re.MULTILINE)
    assert re.search(r"^scene +yade +non-viscous damping of 0\.2, ", done.stdout, re.MULTILINE)
    kept = {path.name for path in (tmp_path / "runs" / "yade").glob("scene-*/*")}
    files = {"chain.py", "run.json", "stdout.txt", "stderr.txt"}
    assert kept == files | {"forces.parquet", "state.parquet"}  # of the refused trace, to see its fault


def swap(engine: str, file: str, good: str, bad: str, stand_in: StandIn, tmp_path: Path) -> None:
    """Replaces the matches of a pattern in all later decks of the real engine."""
    need(engine)
    (tmp_path / "swap.py").write_text(f"""import re
text = open({file!r}).read()
text, count = re.subn({good!r}, {bad!r}, text)
assert count, {good!r}
open({file!r}, "w").write(text)
""")
    found = load_engine(engine).find()
    assert found is not None
    script = f'if [ -e {file} ]; then {sys.executable} {tmp_path}/swap.py || exit 99; fi\nexec {found[0]} "$@"\n'
    stand_in(load_engine(engine).program, script)
