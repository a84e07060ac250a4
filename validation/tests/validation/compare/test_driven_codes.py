"""Driven chains: the codes agree with velocity Verlet, and plans keep their accuracy."""

from pathlib import Path

import pytest

from drivers.chain.schemes import verlet_of
from drivers.chain.trace import residual
from drivers.engines import codes
from drivers.limits import refuse
from drivers.run.compute import compute
from drivers.run.scheme import checked
from validation.accuracy.motions import exact_motion_of
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import case_of

RESET = ("drive.frequency=", "drive.cycles=", "drive.window=", "drive.force=")
PUSH = ("drive.force=", "drive.displacement=-1.5 um")
HEAVY = ("gravity=9.81 m/s^2", "drive.start=12.34 us")
STRUCK = "striker={material='steel', diameter='9 mm', speed='0.2 m/s'}"
FREE = ("chain.precompression=0 N", "wall=")
CHIRP = ("drive.form=chirp", "drive.frequency=2 kHz", "drive.end_frequency=20 kHz", "drive.duration=0.3 ms")
POINTS = "time_us,{}\n0,0\n37.3,{low}\n80.04,{high}\n333,0\n"
CASES = {
    "a sine at an inner bead, gravity": ("drive.from_wall=7", "drive.window=", "drive.cycles=3.3", *HEAVY),
    "a half-sine displacement of a free chain": (
        *RESET, *FREE, "drive.form=half-sine", "drive.duration=50 us", "drive.displacement=-1 um",
    ),
    "a ramp of bead 1": (
        *RESET, *HEAVY, "drive.form=ramp", "drive.duration=60 us", "drive.displacement=1 um", "drive.from_wall=1",
    ),
    "a chirp of displacement": (*RESET, *CHIRP, "drive.displacement=-1.5 um", "drive.window=hann"),
    "forces of a file": (*RESET, "drive.form=file", "drive.file=force_N.csv"),
    "displacements of a file": (*RESET, "drive.form=file", "drive.file=displacement_nm.csv", "drive.start=10 us"),
    "a driven striker": ("drive.window=", STRUCK),
    "damped contacts": (*PUSH, "contact.damping_ratio=0.1", "drive.from_wall=10", "drive.start=1 us"),
}  # fmt: skip


@pytest.mark.parametrize(
    "settings",
    [
        pytest.param(("drive.frequency=1 MHz",), id="rounding separates two runs after 20 of 1001 samples"),
        pytest.param(("drive.frequency=1 MHz", "drive.window=", "drive.cycles="), id="no momentum at any sample"),
    ],
)
def test_right_runs_of_fast_drives_pass(settings: tuple[str, ...]) -> None:
    case = case_of("driven-steel", "wall=", "chain.precompression=", "chain.origin=", *settings)
    for engine in codes():
        need(engine)
        assert compute(case, engine).fault is None, engine


@pytest.mark.parametrize("name", CASES)
def test_codes_agree_with_velocity_verlet_and_a_plan_keeps_its_accuracy(name: str, tmp_path: Path) -> None:
    for unit, low, high in (("force_N", -9, 3), ("displacement_nm", -1500, 500)):
        (tmp_path / f"{unit}.csv").write_text(POINTS.format(unit, low=low, high=high))
    given = (setting.replace("drive.file=", f"drive.file={tmp_path}/") for setting in CASES[name])
    settings = ["run.duration=0.4 ms", *given]
    case = case_of("driven-steel", *settings)
    expected = verlet_of(case)
    for engine in codes():
        need(engine)
        assert residual(compute(case, engine).done, expected).max() < 1e-9, engine
    planned = case_of("driven-steel", *settings, "run.time_step=", "run.accuracy=1e-3")
    trace = checked(planned, verlet_of(planned))
    assert residual(trace, exact_motion_of(planned.full or planned, finer=False).trace).max() <= 1e-3
    refuse(planned, "verlet")
