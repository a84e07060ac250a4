"""Decks with one fault on the real engines: each run fails, and the diagnosis names the fault."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

from drivers.chain.case import Case
from drivers.engines import load_engine
from drivers.run.compute import compute
from validation.compare.diagnosis import diagnosis
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import SceneWriter, StandIn, case_of

DEPARTS = "^departs from its scheme"
UNSTABLE = "^unstable at t = "
NONE = "no single change explains it; "
SENSOR = "chain.sensors=[{from_wall=3, mass='0.116 g'}]"
SCENES = {
    "struck": ("fig4", "chain.count=5", SENSOR, "striker.speed=1 m/s", "run.duration=0.3 ms"),
    "driven": ("driven-steel", "run.duration=0.3 ms"),
    "damped": ("fig4", "chain.count=5", SENSOR, "run.duration=0.3 ms", "contact.restitution=0.8"),
    "kuwabara": (
        "fig4", "chain.count=5", SENSOR, "run.duration=0.3 ms",
        "contact.dissipation=kuwabara-kono", "contact.relaxation=1 us",
    ),
    "tube": ("fig4-tube", "chain.count=5", "chain.sensors=[]", "run.duration=0.15 ms"),
}  # fmt: skip


class Sabotage(NamedTuple):
    """A deck with one fault.

    Attributes:
        fault: name of the fault.
        good, bad: pattern in the deck's files and its replacement.
        red: pattern of the reason why the run fails.
        named: pattern of the diagnosis; empty if there is none.
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
             DEPARTS, r"contact 1 0\.707106[78] times as stiff"),
    Sabotage("liggghts", "a wall of the beads' material", "type 2 zplane", "type 1 zplane",
             DEPARTS, r"contact 1 0\.507292[67] times as stiff"),
    Sabotage("liggghts", "beads of steel", r" 1460000000 (.*\n.*) 0\.46 ", r" 203000000000 \1 0.30 ",
             DEPARTS, r"Young's modulus of ptfe 120\.4615 times the scene's"),
    Sabotage("yade", "all Poisson's ratios forgotten", " poisson=[^,]+,", "", DEPARTS,
             rf"{NONE}largest: stiffness of contact \d 0\.84096\b"),
    Sabotage("yade", "a Young's modulus forgotten", r'(label="ptfe",) young=[^,]+, poisson=[^,]+,', r"\1",
             DEPARTS, r"Young's modulus of ptfe 0\.576 times the scene's"),
    Sabotage("liggghts", "a stiffness off by 1e-5", r" 1460000000 ", " 1460014600 ",
             DEPARTS, r"Young's modulus of ptfe 1\.00001 times the scene's"),
    # dissipation
    Sabotage("yade", "the default damping", "damping=0, ", "",
             DEPARTS, r"non-viscous damping of 0\.2$"),
    Sabotage("lammps", "viscous damping", r"0 (tangential linear_nohistory 0 0) damping velocity",
             r"0.9 \1 damping tsuji limit_damping",
             DEPARTS, r"contacts with a damping ratio of 0\.0215955"),
    Sabotage("lammps", "a drag", "fix motion", "fix drag all viscous 1e-4\nfix motion",
             DEPARTS, r"a viscous drag of 0\.0001 N s/m on each body"),
    Sabotage("yade", "a coefficient off by 1e-3", r"betan = ([\d.e-]+)", r"betan = \1 * 1.001", DEPARTS,
             r"dissipation 1\.001 times the scene's", "damped"),
    Sabotage("lammps", "a coefficient off by 1e-3", r"30209655\.005739838", "30239864.660745578",
             DEPARTS, NONE, "kuwabara"),
    Sabotage("kratos", "a coefficient off by 1e-3", r"(GAMMA\] = [\d.e-]+)", r"\1 * 1.001", DEPARTS,
             r"dissipation 1\.001 times the scene's", "damped"),
    # masses, loads, start
    Sabotage("kratos", "a sensor's mass", "= mass / ", "= bodies[0][2] / ",
             DEPARTS, r"bead 3 with 1\.05689[67]\d* of its mass"),
    Sabotage("liggghts", "a sensor's mass", r"\n3 1 0.00476 2054\.\d+", r"\n3 1 0.00476 2171.0558198513872",
             DEPARTS, r"bead 3 with 1\.05689[67]\d* of its mass"),
    Sabotage("yade", "a mass off by 1e-5", r"body\.state\.mass = mass", r"\g<0> * (1 + 1e-5 * (0.0115 < z < 0.0125))",
             DEPARTS, r"bead 3 with 1\.00001 of its mass"),
    Sabotage("liggghts", "gravity forgotten", "fix weight.*\n", "", DEPARTS, "loads 0 times the scene's$"),
    Sabotage("yade", "twice the gravity", r"\ng = ([\d.]+)", r"\ng = 2 * \1", DEPARTS,
             "loads 2 times the scene's$"),
    Sabotage("lammps", "a little force", "fix motion", "fix push all addforce 0 0 -1e-3\nfix motion",
             DEPARTS, NONE),
    Sabotage("liggghts", "a striker at rest", "6 0 0 -1 0 0 0", "6 0 0 0 0 0 0",
             DEPARTS, "start speeds 0 times the scene's"),
    Sabotage("yade", "a slower strike", r"\(0, 0, velocity\)", "(0, 0, 0.9 * velocity)",
             DEPARTS, r"start speeds 0\.9\d* times the scene's"),
    Sabotage("liggghts", "velocities half a step off", "6 0 0 -1 0 0 0", "6 0 0 -0.9999995095 0 0 0",
             DEPARTS, r"start speeds 0\.9999995 times the scene's"),
    Sabotage("yade", "velocities half a step off", r"-0\.9999995095", "-1",
             DEPARTS, r"start speeds 1 times the scene's"),
    # clock
    Sabotage("liggghts", "forces one step early", "dump samples all", "run 1\nreset_timestep 0\ndump samples all",
             "height of", NONE),
    Sabotage("yade", "forces one step late", "every if sample", "every - (sample == 1) if sample",
             DEPARTS, NONE),
    Sabotage("yade", "a step left out of each sample", "range.every if", "range(9 if", DEPARTS, NONE),
    Sabotage("lammps", "a larger time step", r"timestep +\S+", "timestep 1.1e-07", DEPARTS,
             r"a time step 1\.1 times the scene's"),
    Sabotage("liggghts", "half the time step", r"timestep +\S+", "timestep 0.05e-6", DEPARTS,
             r"a time step 0\.5 times the scene's"),
    Sabotage("yade", "half the time step", "O.dt = time_step", "O.dt = time_step / 2", "height of", NONE),
    Sabotage("kratos", "forces one step late", r"DELTA_TIME\] = 0 ", "DELTA_TIME] = time_step ", "height of", NONE),
    # drives
    Sabotage("lammps", "another frequency", "50265.48", "50768.13", DEPARTS, NONE, "driven"),
    Sabotage("liggghts", "no drive", "fix drive .*\n", "\n", DEPARTS, NONE, "driven"),
    Sabotage("liggghts", "a drive of another bead", "driven id 20", "driven id 19", DEPARTS, NONE, "driven"),
    Sabotage("yade", "a drive one step early", "tau = step ", "tau = (step + 1) ", DEPARTS, NONE, "driven"),
    # tubes, in three dimensions, where no cause is sought
    Sabotage("lammps", "a friction off by 0.001", r"(mindlin \S+ 0) 0\.05", r"\1 0.051", DEPARTS, "", "tube"),
    Sabotage("lammps", "a bore wider by 0.1 um", "zcylinder 0.0025", "zcylinder 0.00250005", DEPARTS, "", "tube"),
    Sabotage("lammps", "no rotation", "nve/sphere", "nve", DEPARTS, "", "tube"),
    Sabotage("lammps", "a shear that shrinks in opening contacts", "mindlin ", "mindlin_rescale ", DEPARTS, "", "tube"),
    Sabotage("liggghts", "a bore wider by 0.1 um", "zcylinder 0.0025", "zcylinder 0.00250005", DEPARTS, "", "tube"),
    Sabotage("yade", "a friction off by 0.001", r"(frictionAngle=|tangensOfFrictionAngle = )0\.0[45]\d*", r"\g<1>0.051",
             DEPARTS, "", "tube"),
    # ends
    Sabotage("lammps", "NaN", "timestep        1e-07", "timestep        1e200", "simulation unstable"),
    Sabotage("lammps", "a step far too large", "timestep        1e-07", "timestep        2.5e-05", UNSTABLE),
    Sabotage("liggghts", "no wall at 0", "zplane 0", "zplane -1", DEPARTS),
    Sabotage("lammps", "a lost bead", "fix motion", "fix push all addforce 1000 0 0\nfix motion",
             "Lost atoms"),
    Sabotage("liggghts", "half way", "run             3000", "run             1500", "ends in sample 152 of 301"),
    Sabotage("yade", "half way", r"np.savez\(", "force = force[:150]\nnp.savez(", r"shape \(150, 6\)"),
    Sabotage("lammps", "an error in the deck", "pair_style      gran", "pair_style      grain", "pair style"),
    Sabotage("yade", "an error in the deck", "O.dt = time_step", "O.dt = steptime", "name 'steptime' is not defined"),
    Sabotage("kratos", "an error in the deck", "SphericParticle3D", "Sphere3D", r'The Element "Sphere3D" is not reg'),
    Sabotage("yade", "death before the end", r"start = time.perf_counter\(\)", "import os; os._exit(0)",
             "was not written"),
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
    assert ended.fault is not None
    assert re.search(row.red, str(ended.fault)), ended.fault
    if row.named:
        assert ended.fault.partial is not None
        _, cause = diagnosis(case, row.engine, ended.fault.partial)
        assert re.match(row.named, cause), cause


def test_the_comparison_prints_departure_and_diagnosis(
    stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path
) -> None:
    """A build that forgets gravity fails, and its refused trace is kept to see the fault."""
    need("liggghts")
    found = load_engine("liggghts").find()
    assert found is not None
    stand_in("liggghts", f'[ ! -e chain.in ] || sed -i "/^fix weight/d" chain.in\nexec {found[0]} "$@"\n')
    words = ("--runs", tmp_path / "runs", "--engine", "liggghts")
    done = beads("compare", scene_file(top='gravity = "9.81 m/s^2"'), *words)
    assert done.returncode == 1, done.stderr
    assert re.search("fail: failed: departs from its scheme from .* before any wave arrives: ", done.stdout)
    assert re.search(r"^scene +liggghts +loads 0 times the scene's$", done.stdout, re.MULTILINE), done.stdout
    kept = {path.name for path in (tmp_path / "runs" / "liggghts").glob("scene-*/*")}
    assert kept == {"chain.in", "chain.data", "run.json", "stdout.txt", "stderr.txt", "forces.parquet", "state.parquet"}
