"""Driven chains on the codes: they agree with velocity Verlet, and a deck with a wrong drive is red."""

from pathlib import Path

import pytest

from drivers.chain.schemes import verlet_of
from drivers.engines import codes
from postproc.read.residual import residual
from validation.checks import FAIL
from validation.compare.selection import EngineSelection
from validation.tests.helpers.runs import finished, run_and_compare
from validation.tests.helpers.scenes import StandIn, case_of
from validation.tests.validation.compare.test_sabotage import DECK, YADE, swap

RESET = ("drive.frequency=", "drive.cycles=", "drive.window=", "drive.force=")
PUSH = ("drive.force=", "drive.displacement=-1.5 um")
HEAVY = ("gravity=9.81 m/s^2", "drive.start=12.34 us")
STRUCK = "striker={material='steel', diameter='9 mm', speed='0.2 m/s'}"
FREE = ("chain.precompression=0 N", "wall=")
CHIRP = ("drive.form=chirp", "drive.frequency=2 kHz", "drive.end_frequency=20 kHz", "drive.duration=0.3 ms")
POINTS = "time_us,{}\n0,0\n37.3,{low}\n80.04,{high}\n333,0\n"
CASES = {
    "the shipped scene": (),
    "a burst of displacement": PUSH,
    "a sine at an inner bead, gravity": ("drive.from_wall=7", "drive.window=", "drive.cycles=3.3", *HEAVY),
    "a half-sine through a free chain": (
        *RESET, *FREE, "drive.form=half-sine", "drive.duration=50 us", "drive.force=-20 N",
    ),
    "a half-sine displacement of a free chain": (
        *RESET, *FREE, "drive.form=half-sine", "drive.duration=50 us", "drive.displacement=-1 um",
    ),
    "a step": (*RESET, *HEAVY, "drive.form=step", "drive.force=-9 N"),
    "a ramp of bead 1": (
        *RESET, *HEAVY, "drive.form=ramp", "drive.duration=60 us", "drive.displacement=1 um", "drive.from_wall=1",
    ),
    "a chirp": (*RESET, *CHIRP, "drive.force=-5 N"),
    "a chirp of displacement": (*RESET, *CHIRP, "drive.displacement=-1.5 um", "drive.window=hann"),
    "forces of a file": (*RESET, "drive.form=file", "drive.file=force_N.csv"),
    "displacements of a file": (*RESET, "drive.form=file", "drive.file=displacement_nm.csv", "drive.start=10 us"),
    "a driven striker": ("drive.window=", STRUCK),
    "a driven bead under a striker": (*PUSH, "drive.from_wall=15", STRUCK),
    "damped contacts, force": ("contact.damping_ratio=0.1",),
    "damped contacts, displacement": (*PUSH, "contact.damping_ratio=0.1", "drive.from_wall=10", "drive.start=1 us"),
}  # fmt: skip
QUICK = ("a burst of displacement", "a sine at an inner bead, gravity", "displacements of a file")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name in QUICK else pytest.mark.long) for name in CASES]
)
def test_the_codes_agree_with_velocity_verlet(name: str, tmp_path: Path, shared_runs: Path) -> None:
    for unit, low, high in (("force_N", -9, 3), ("displacement_nm", -1500, 500)):
        (tmp_path / f"{unit}.csv").write_text(POINTS.format(unit, low=low, high=high))
    settings = (each.replace("drive.file=", f"drive.file={tmp_path}/") for each in CASES[name])
    case = case_of("driven-steel", "run.duration=0.4 ms", *settings)
    expected = verlet_of(case)
    for engine in codes():
        assert residual(finished(case, engine, shared_runs).trace, expected).max() < 1e-9, engine


@pytest.mark.parametrize(
    ("engine", "file", "good", "bad"),
    [
        ("lammps", DECK, "50265.48", "50768.13"),
        pytest.param("lammps", DECK, r"equal -5\*", "equal -5.005*", marks=pytest.mark.long),
        ("liggghts", DECK, "fix drive .*\n", "\n"),
        pytest.param("liggghts", DECK, "group driven id 20", "group driven id 19", marks=pytest.mark.long),
        pytest.param("yade", YADE, r"setPermF\(bodies\[19\]", "setPermF(bodies[18]", marks=pytest.mark.long),
        pytest.param("yade", YADE, "tau = step ", "tau = (step + 1) ", marks=pytest.mark.long),
    ],
)
def test_a_wrong_drive_is_red(engine: str, file: str, good: str, bad: str, stand_in: StandIn, tmp_path: Path) -> None:
    swap(engine, file, good, bad, stand_in, tmp_path)
    asked = EngineSelection((engine,))
    compared = run_and_compare("driven-steel", ("run.duration=0.3 ms",), runs=tmp_path / "runs", asked=asked)
    red = {check.quantity for check in compared.of_engine(engine) if check.verdict == FAIL}
    assert red & {"model: force", "run"}
