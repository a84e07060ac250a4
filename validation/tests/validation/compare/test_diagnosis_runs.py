"""Real engines with sabotaged decks: each run fails, and its diagnosis names the fault."""

import re
import shutil
import sys
from pathlib import Path

import pytest

from drivers.engines import load_engine
from validation.compare.comparison import REFUSED, ComparedScene, run_and_compare
from validation.compare.selection import EngineSelection
from validation.compare.verdict import FAIL
from validation.tests.helpers.commands import command_line
from validation.tests.helpers.runs import finished, need
from validation.tests.helpers.scenes import SceneWriter, StandIn, case_of

DECK, YADE, DATA = "chain.in", "chain.py", "chain.data"
SENSOR = 'sensors = [{ from_wall = 3, mass = "0.116 g" }]'
IN_REPOSITORY = ("reference", "verlet")
STEEL_BEADS = "matches (beads of steel|steel in place of ptfe)"
GRAVITY = 'gravity = "9.81 m/s^2"'
# file, pattern, replacement, and pattern of the diagnosis
SABOTAGE = {
    ("yade", "the default wall law"): (
        YADE, r"Ig2_Wall_Sphere_ScGeom\(hertzian=True\)", "Ig2_Wall_Sphere_ScGeom()",
        r"matches a wall contact 0\.707107 times as stiff as with brass, the default of YADE",
    ),
    ("yade", "the default damping"): (
        YADE, "damping=0, ", "", r"matches non-viscous damping of 0\.2, the default of YADE",
    ),
    ("yade", "some damping"): (YADE, "damping=0", "damping=0.03", r"matches non-viscous damping of 0\.03 to "),
    ("lammps", "a wall contact too stiff"): (
        DECK, r"(wall/gran granular hertz) \S+", r"\1 4867280554.542816",
        r"matches a wall contact 2 times as stiff",
    ),
    ("lammps", "the viscous damping"): (
        DECK, r"0 (tangential linear_nohistory 0 0) damping velocity",
        r"0.9 \1 damping tsuji limit_damping", r"matches contacts of damping ratio 0\.0\d+",
    ),
    ("lammps", "gravity forgotten"): (DECK, "fix weight.*\n", "", "matches the scene without gravity"),
    ("liggghts", "the viscous damping"): (
        DECK, r"(coefficientRestitution peratomtypepair 2) 1 1 1 1", r"\1 0.9 0.9 0.9 0.9",
        r"matches contacts of damping ratio 0\.030598, with attraction.*coefficientRestitution of 0\.9\)",
    ),
    ("liggghts", "a sensor's mass"): (
        DATA, r"\n3 1 0.00476 2054\.\d+", r"\n3 1 0.00476 2171.0558198513872",
        r"matches bead 3 weighing 0\.1226 g \(the scene has 0\.116\)",
    ),
    ("yade", "a sensor's mass"): (
        YADE, "0.000116", "0.00011", r"matches bead 3 weighing 0\.11 g \(the scene has 0\.116\)",
    ),
    ("liggghts", "velocities half a step off"): (
        DATA, r"6 0 0 -1 0 0 0", "6 0 0 -0.9999995095 0 0 0", "matches velocities that start half a step behind",
    ),
    ("yade", "velocities half a step off"): (
        YADE, r"-0\.9999995095", "-1", "matches velocities that start half a step ahead",
    ),
    ("liggghts", "forces stamped one step early"): (
        DECK, "dump samples all", "run 1\nreset_timestep 0\ndump samples all",
        r"matches forces stamped one time step \(0\.1 µs\) early",
    ),
    ("yade", "forces stamped one step early"): (
        YADE, "if sample else 1", "if sample else 2", r"matches forces stamped one time step \(0\.1 µs\) early",
    ),
    ("yade", "forces stamped one step late"): (
        YADE, "every if sample", "every - (sample == 1) if sample",
        r"matches forces stamped one time step \(0\.1 µs\) late",
    ),
    ("liggghts", "a striker without its speed"): (DATA, "6 0 0 -1 0 0 0", "6 0 0 0 0 0 0", "matches a striker at rest"),
    ("yade", "a striker without its speed"): (YADE, r"-0\.9999995095", "0", "matches a striker at rest"),
    ("liggghts", "gravity forgotten"): (DECK, "fix weight.*\n", "", "matches the scene without gravity"),
    ("yade", "gravity forgotten"): (YADE, r", gravity=\(0, 0, -g\)", "", "matches the scene without gravity"),
    ("liggghts", "beads of steel"): (
        DECK, r" 1460000000 (.*\n.*) 0\.46 ", r" 203000000000 \1 0.30 ", STEEL_BEADS,
    ),
    ("yade", "beads of steel"): (
        YADE, r"young=1460000000, poisson=0\.46", "young=203e9, poisson=0.3", STEEL_BEADS,
    ),
    ("liggghts", "a wall of the beads' material"): (
        DECK, "type 2 zplane", "type 1 zplane", "matches a wall of ptfe",
    ),
    ("yade", "a wall of the beads' material"): (
        YADE, r'sense=1, material="brass"', 'sense=1, material="ptfe"', "matches a wall of ptfe",
    ),
    ("yade", "all Poisson's ratios forgotten"): (
        YADE, " poisson=[^,]+,", "", r"matches all materials with YADE's default Poisson's ratio of 0\.25 ",
    ),
    ("yade", "a Poisson's ratio forgotten"): (
        YADE, r'(label="ptfe", young=[^,]+,) poisson=[^,]+,', r"\1",
        r"matches ptfe with YADE's default Poisson's ratio of 0\.25 ",
    ),
    ("yade", "all Young's moduli forgotten"): (
        YADE, " young=[^,]+,", "", "matches all materials with YADE's default Young's modulus of 1 GPa ",
    ),
    ("yade", "a material without elastic constants"): (
        YADE, r'(label="ptfe",) young=[^,]+, poisson=[^,]+,', r"\1",
        r"matches ptfe with YADE's default Young's modulus of 1 GPa and Poisson's ratio of 0\.25 ",
    ),
    ("yade", "half the time step"): (
        YADE, "O.dt = time_step", "O.dt = time_step / 2",
        r"matches a time step of 0\.05 µs \(the scene has 0\.1\) with the scene's time stamps, "
        "with velocities set back by half the scene's step to ",
    ),
    ("yade", "half the time step, twice the steps"): (
        YADE, "O.dt = time_step", "O.dt = time_step / 2; every *= 2",
        r"matches a time step of 0\.05 µs \(the scene has 0\.1\), "
        "with velocities set back by half the scene's step to ",
    ),
    ("liggghts", "half the time step"): (
        DECK, r"timestep +\S+", "timestep 0.05e-6",
        r"matches a time step of 0\.05 µs \(the scene has 0\.1\) with the scene's time stamps to ",
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


@pytest.mark.parametrize(
    ("engine", "name"), [pytest.param(*key, marks=() if key in QUICK else pytest.mark.long) for key in SABOTAGE]
)
def test_a_sabotaged_deck_is_red_and_named(
    engine: str, name: str, stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path, shared_runs: Path
) -> None:
    scene = scene_file(top=GRAVITY, chain=SENSOR)
    for name_ in IN_REPOSITORY:  # the same for every deck
        run = finished(case_of(scene), name_, shared_runs).folder
        shutil.copytree(run, tmp_path / "runs" / name_ / run.name)
    compared = sabotaged(engine, name, stand_in, scene, tmp_path)
    assert FAIL in {verdict.verdict for verdict in compared.verdicts if verdict.engine == engine}
    assert set(compared.diagnoses) == {engine}
    assert re.match(SABOTAGE[engine, name][3], compared.diagnoses[engine]), compared.diagnoses[engine]
    closely = re.search(r" to (\S+) of the largest change$", compared.diagnoses[engine])
    assert closely is None or float(closely[1]) <= 1e-9  # measured up to 2e-11; else bit for bit


@pytest.mark.long
def test_the_comparison_prints_the_diagnosis(stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path) -> None:
    swap("yade", YADE, "damping=0, ", "", stand_in, tmp_path)
    done = command_line("validation", "compare", scene_file(top=GRAVITY), "--runs", tmp_path / "runs")
    assert done.returncode == 1, done.stderr
    (line,) = [line for line in done.stdout.splitlines() if "diagnosis:" in line]
    assert re.match(r"scene +yade +diagnosis: matches non-viscous damping of 0\.2, ", line)
    (line,) = [line for line in done.stdout.splitlines() if re.match(r"scene +yade +(deviates|wrong start)", line)]
    assert re.search(r": (model|set-up)|, in the wave: model", line)  # for a trace that a guard refused
    kept = {path.name for path in (tmp_path / "runs" / "yade").glob("scene-*/*")}
    assert kept == {"chain.py", "run.json", "stdout.txt", "stderr.txt"}  # no part of the refused trace


def sabotaged(engine: str, name: str, stand_in: StandIn, scene: Path, tmp_path: Path) -> ComparedScene:
    """Runs the small scene with gravity and a sensor on an engine with a changed deck, and on the in-repo engines."""
    file, good, bad, _ = SABOTAGE[engine, name]
    swap(engine, file, good, bad, stand_in, tmp_path)
    compared = run_and_compare(scene, runs=tmp_path / "runs", asked=EngineSelection((engine,)))
    assert not any(why.startswith(REFUSED) for why in compared.absent.values())
    return compared


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
