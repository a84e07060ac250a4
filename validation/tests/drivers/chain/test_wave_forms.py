"""Wave forms of drives, their work, the balances that follow from samples, and wrong drives of scenes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.base.errors import InputError, RunError
from drivers.chain.case import Case
from drivers.chain.drives import drive_of, pieces_of
from drivers.chain.schemes import exact_of, verlet_in_heights, verlet_of
from drivers.engines import load_engine
from drivers.run.run_folder import in_si
from drivers.run.scheme import compared
from drivers.scene.read_scene import changed_scene, stored_scene
from postproc.read.observables import observe
from validation.tests.helpers.scenes import case_of

SCENE = "driven-steel"
RESET = ("drive.frequency=", "drive.cycles=", "drive.window=", "drive.force=")
SINE = ("drive.window=", "drive.force=2 N", "drive.start=10 us")
PUSH = ("drive.force=", "drive.displacement=-200 nm")
HALF = (*RESET, "drive.form=half-sine", "drive.duration=50 us", "drive.displacement=-200 nm")
TIMES_S = np.array([0.0, 9.9e-6, 1e-5, 3e-5, 6e-5, 1e-4, 9e-4])
TAU_S = TIMES_S - 1e-5


def values_of(case: Case) -> np.ndarray:
    drive = drive_of(case.scene)
    assert drive is not None
    return drive.at(TIMES_S)[0]


def test_values_of_the_wave_forms() -> None:
    sine = 2 * np.sin(2 * np.pi * 8e3 * TAU_S) * (TAU_S >= 0)
    window = (1 - np.cos(2 * np.pi * TAU_S / 1e-4)) / 2 * (TAU_S <= 1e-4)
    other = (*RESET, "drive.start=10 us", "drive.force=2 N", "drive.duration=0.1 ms")
    chirp = ("drive.form=chirp", "drive.frequency=8 kHz", "drive.end_frequency=12 kHz")
    swept = 2 * np.sin(2 * np.pi * (8e3 * TAU_S + 2e7 * TAU_S**2)) * (TAU_S >= 0)
    expected = {
        (*SINE, "drive.cycles="): sine,
        (*SINE, "drive.cycles=0.25"): np.where(TAU_S < 0.25 / 8e3, sine, 2.0),
        (*SINE, "drive.cycles=0.8", "drive.window=hann"): sine * window,
        (*other, "drive.form=half-sine"): 2 * np.sin(np.pi * TAU_S / 1e-4) * (TAU_S >= 0) * (TAU_S < 1e-4),
        (*other[:-1], "drive.form=step"): 2.0 * (TAU_S >= 0),
        (*other, "drive.form=ramp"): 2 * np.clip(TAU_S / 1e-4, 0, 1),
        (*other, *chirp): np.where(TAU_S < 1e-4, swept, 0.0),
        (*other, *chirp, "drive.window=hann"): swept * window,
    }
    for settings, values in expected.items():
        np.testing.assert_allclose(values_of(case_of(SCENE, *settings)), values, atol=1e-12, err_msg=str(settings))


def test_points_of_a_file_are_stored_and_its_name_is_not(tmp_path: Path) -> None:
    text = "# piezo\ntime_us,force_mN\n20,0\n50, 3000\n90,1000\n"
    settings = (*RESET, "drive.form=file", "drive.start=10 us")

    def stored(name: str, text: str) -> Case:
        (tmp_path / name).write_text(text)
        return case_of(SCENE, *settings, f"drive.file={tmp_path / name}")

    one, other, third = stored("one.csv", text), stored("other.csv", text), stored("one.csv", text.replace("30", "31"))
    np.testing.assert_allclose(values_of(one), [0, 0, 0, 0, 3, 1, 1], atol=1e-12)
    assert load_engine("lammps").render(one).sha256 == load_engine("lammps").render(other).sha256
    assert in_si(one.scene) == in_si(other.scene) == in_si(stored_scene(in_si(one.scene))) != in_si(third.scene)
    changed = changed_scene(in_si(one.scene), ("run.duration=50 us",), "a run")
    assert (changed.drive, changed.run.duration) == (stored_scene(in_si(one.scene)).drive, 5e-5)


def test_steps_of_the_segments() -> None:
    drive = drive_of(case_of(SCENE, *SINE, "drive.cycles=2.41").scene)
    pieces = pieces_of(drive, 1e-7, 10_000)
    assert [(piece["first"], piece["until"]) for piece in pieces] == [(0, 99), (100, 3112), (3113, 10_000)]
    assert [piece["until"] for piece in pieces_of(drive, 1e-7, 50)] == [50]


@pytest.mark.parametrize(
    "settings", [(), (*HALF, "drive.from_wall=7"), ("drive.from_wall=1",), (*PUSH, "wall=", "gravity=")]
)
def test_energy_and_momentum_balance_with_the_work_of_the_drive(settings: tuple[str, ...]) -> None:
    case = case_of(SCENE, *settings)
    for trace in (exact_of(case), verlet_of(case)):
        assert trace.drive_work_J is not None
        work = float(np.abs(trace.drive_work_J).max())
        assert np.ptp(trace.total_energy_J) < 4e-5 * work
        assert observe(case.layout, trace)["impulse_imbalance_share"] < 1e-5


def test_the_work_of_the_drive_of_a_code_is_that_of_its_scheme_also_between_coarse_samples() -> None:
    case, code = case_of(SCENE, *HALF, "run.sample_interval=20 us"), load_engine("lammps")
    read, scheme = verlet_in_heights(case), verlet_of(case)
    assert read.drive_work_J is None
    trace = compared(case, code, read)
    assert trace.drive_work_J is not None
    np.testing.assert_array_equal(trace.drive_work_J, scheme.drive_work_J)
    np.testing.assert_array_equal(trace.total_energy_J, read.total_energy_J - trace.drive_work_J)
    wrong = replace(read, total_energy_J=read.total_energy_J + 1e-6 * trace.drive_work_J)
    with pytest.raises(RunError, match=r"departs from its scheme .*: the energy is "):
        compared(case, code, wrong)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (("drive.frequency=0 Hz",), 'found "0 Hz"; allowed: a frequency above zero'),
        (("drive.cycles=",), "a window needs a number of cycles"),
        (("drive.displacement=1 nm",), "force and displacement; allowed: exactly one"),
        (("drive.duration=1 us",), 'only with drive.form = "half-sine" or "ramp" or "chirp"'),
        (("drive.from_wall=21",), "1 to 20, the beads of the chain"),
        (("drive.start=1 s",), "below run.duration"),
        (
            (*RESET, "drive.form=step", "drive.displacement=1 nm"),
            '= "sine" or "half-sine" or "ramp"',
        ),
        ((*RESET, "drive.form=file"), "drive.file: missing key"),
        ((*PUSH, "chain.bead=[{from_wall=20, velocity='1 m/s'}]"), "chain.bead.0.velocity"),
        ((*PUSH, "striker={material='steel', diameter='9 mm', speed='1 m/s'}"), "drive.from_wall of a bead"),
        (("chain.bead=[{from_wall=3, lateral_velocity='1 m/s'}]",), "a drive of a straight chain"),
    ],
)
def test_wrong_drives_are_refused_in_one_line(settings: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError, match=message) as refused:
        case_of(SCENE, *settings)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_us,force_nm\n0,1\n1,2\n", "two headings with units"),
        ("time_us,force_mN\n0,1\n", "found 1 rows"),
        ("time_us,force_mN\n0,1\n2,3\n2,4\n", 'line 4: found "2,4"'),
        ("time_us,force_mN\n-1,1\n2,3\n", 'line 2: found "-1,1"'),
        ("time_us,force_mN\n0,1\n2,nan\n", 'line 3: found "2,nan"'),
        ("time_us,displacement_nm\n0,1\n2,3\n", "0 first, the displacement at time 0"),
    ],
)
def test_wrong_files_of_points_are_refused_by_line(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        case_of(SCENE, *RESET, "drive.form=file", f"drive.file={tmp_path / 'points.csv'}")
