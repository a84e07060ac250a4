"""Tests of runs: run once, found by their hash, never incomplete; and all failures of engines."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.base.errors import InputError, RunError
from drivers.engines import load_engine, missing_codes
from drivers.run.run import run_case, run_many
from drivers.run.run_folder import open_run
from validation.accuracy.assess import assess
from validation.tests.helpers.commands import BEADS, beads, beads_process
from validation.tests.helpers.runs import assessed, failing_run, finished, need
from validation.tests.helpers.scenes import SceneWriter, StandIn, case_of


def test_a_done_run_is_found_again_under_any_name(scene_file: SceneWriter, tmp_path: Path) -> None:
    first = run_case(case_of(scene_file("one")), "verlet", tmp_path / "runs")
    stamp = (first.folder / "forces.parquet").stat().st_mtime_ns
    again = run_case(case_of(scene_file("two")), "verlet", tmp_path / "runs")
    assert again.folder == first.folder
    assert (again.folder / "forces.parquet").stat().st_mtime_ns == stamp
    assert again.record.scene_name == "two"
    anew = run_case(case_of(scene_file("two")), "verlet", tmp_path / "runs", rerun=True)
    assert anew.folder.name.startswith("two-")
    assert not first.folder.exists()


def test_a_changed_scene_is_another_run(scene_file: SceneWriter, tmp_path: Path) -> None:
    one = run_case(case_of(scene_file()), "verlet", tmp_path / "runs")
    other = run_case(case_of(scene_file(), "striker.speed=1.0000001 m/s"), "verlet", tmp_path / "runs")
    assert one.folder != other.folder


def test_what_a_run_folder_holds(scene_file: SceneWriter, tmp_path: Path) -> None:
    path = scene_file(chain='sensors = [{ from_wall = 2 }]\nbead = [{ from_wall = 1, velocity = "0 m/s" }]')
    run = finished(case_of(path, "run.record=['forces', 'state']"), "verlet", tmp_path / "runs")
    names = {file.name for file in run.folder.iterdir()}
    assert names == {
        "chain.json", "stdout.txt", "stderr.txt", "forces.parquet", "state.parquet", "sensors.csv", "run.json",
    }  # fmt: skip
    forces = pd.read_parquet(run.folder / "forces.parquet")
    sensors = pd.read_csv(run.folder / "sensors.csv")
    assert list(forces.columns) == [
        "time_s", *(f"contact_{j}_N" for j in range(1, 7)), "kinetic_energy_J", "total_energy_J", "momentum_N_s",
    ]  # fmt: skip
    assert list(sensors.columns) == ["time_s", "bead_2_N", "wall_N"]
    np.testing.assert_array_equal(sensors["bead_2_N"], (forces["contact_2_N"] + forces["contact_3_N"]) / 2)
    record = json.loads((run.folder / "run.json").read_text())
    assert record["status"] == "done"
    assert record["scene"]["chain"]["mass"] == 0.0001226
    assert record["steps"] == 3000
    assert 0 < record["loop_s"] < record["wall_s"]
    assert record["commit"]


def test_a_sensor_that_moves_reads_another_contact_of_the_same_run(scene_file: SceneWriter, tmp_path: Path) -> None:
    case, runs = case_of(scene_file(chain="sensors = [{ from_wall = 2 }]")), tmp_path / "runs"
    first = assessed(case, "verlet", runs)
    moved = assessed(case_of(scene_file(), "chain.sensors=[{from_wall=4}]"), "verlet", runs)
    assert moved.folder != first.folder
    assert moved.record.wall_s == first.record.wall_s, "found, not run again"
    for ended, place in ((first, 2), (moved, 4)):
        assert list(pd.read_csv(ended.folder / "sensors.csv").columns) == ["time_s", f"bead_{place}_N", "wall_N"]
        assert open_run(ended.folder).layout.sensors[0].from_wall == place


def test_each_scene_keeps_its_gauges_in_any_order(scene_file: SceneWriter, tmp_path: Path) -> None:
    """Scenes that differ in their electronics only: run, found, run again, failed."""
    path, runs = scene_file(chain="sensors = [{ from_wall = 2 }]"), tmp_path / "runs"
    cases = [
        case_of(path, *setting) for setting in ((), *((f"sensor.time_constant={tau}",) for tau in ("1 ms", "50 us")))
    ]
    tables: dict[Path, bytes] = {}
    for place in (1, 0, 2, 1, 0, 0, 2):
        folder = assessed(cases[place], "verlet", runs).folder
        assert tables.setdefault(folder, (folder / "sensors.csv").read_bytes()) == (folder / "sensors.csv").read_bytes()
        assert open_run(folder).layout == cases[place].layout
    assert len(set(tables.values())) == len(tables) == 3
    ended = run_case(cases[0], "verlet", runs, rerun=True)
    assert not run_case(cases[1], "verlet", runs, rerun=True, limit_s=1e-6).done
    shared = run_many([(case, "verlet") for case in (*cases, cases[0])], tmp_path / "fresh")
    assert len({each.folder for each in shared}) == len({each.record.wall_s for each in shared}) + 2 == 3
    assert [each.layout for each in shared] == [case.layout for case in (*cases, cases[0])]
    assert {folder: (folder / "sensors.csv").read_bytes() for folder in tables if folder != ended.folder} == {
        folder: table for folder, table in tables.items() if folder != ended.folder
    }


def test_a_run_is_assessed_once_for_each_scene(scene_file: SceneWriter, tmp_path: Path) -> None:
    case, runs = case_of(scene_file("one")), tmp_path / "runs"
    bare = run_case(case, "verlet", runs)
    assert (bare.record.error_budget, bare.record.warnings) == (None, None)
    assert not (bare.folder / "sensors.csv").exists()
    once = assess(bare, case)
    assert once.record.error_budget
    stamp = (bare.folder / "run.json").stat().st_mtime_ns
    assert assess(run_case(case, "verlet", runs), case).record.error_budget == once.record.error_budget
    assert (bare.folder / "run.json").stat().st_mtime_ns == stamp
    other = run_case(case_of(scene_file("two")), "verlet", runs)
    assert other.folder == bare.folder
    assert other.record.error_budget is None


def test_the_reference_serves_every_time_step(scene_file: SceneWriter, tmp_path: Path) -> None:
    folders = {
        run_case(case_of(scene_file(), f"run.time_step={step}"), "reference", tmp_path / "runs").folder
        for step in ("0.1 us", "0.2 us", "1 us")
    }
    assert len(folders) == 1


def test_what_the_deck_leaves_out_is_still_another_run(scene_file: SceneWriter, tmp_path: Path) -> None:
    for engine in ("verlet", "reference"):
        here = run_case(case_of(scene_file()), engine, tmp_path / "runs")
        higher = run_case(case_of(scene_file(), "chain.origin=1 m"), engine, tmp_path / "runs")
        assert here.folder != higher.folder


def test_a_failure_does_not_destroy_what_is_done(scene_file: SceneWriter, tmp_path: Path) -> None:
    case, runs = case_of(scene_file()), tmp_path / "runs"
    good = run_case(case, "verlet", runs)
    bad = run_case(case, "verlet", runs, rerun=True, limit_s=1e-6)
    assert bad.record.status == "timeout"
    assert bad.folder != good.folder
    assert run_case(case, "verlet", runs).folder == good.folder


def test_damaged_records_and_forces(scene_file: SceneWriter, tmp_path: Path) -> None:
    case, runs = case_of(scene_file()), tmp_path / "runs"
    folder = run_case(case, "verlet", runs).folder
    (folder / "forces.parquet").write_bytes(b"PAR1 junk PAR1")
    with pytest.raises(InputError, match="altered"):
        len(open_run(folder).trace.time_s)
    assert run_case(case, "verlet", runs).folder == folder
    assert len(open_run(folder).trace.time_s) == 301
    record = json.loads((folder / "run.json").read_text())
    (folder / "run.json").write_text(json.dumps(record | {"layout": 5}))
    with pytest.raises(InputError, match="altered"):
        open_run(folder)
    (folder / "run.json").write_text("[" * 100_000)
    with pytest.raises(InputError, match="damaged"):
        open_run(folder)


def test_a_weak_impact_under_gravity_is_no_instability(scene_file: SceneWriter, tmp_path: Path) -> None:
    path = scene_file(count=0, top='gravity = "9.81 m/s^2"', step="1 us")
    assert run_case(case_of(path, "striker.speed=1e-6 m/s"), "verlet", tmp_path / "runs").done


def byte(place: int) -> str:
    """Command that overwrites a byte of a file."""
    return f"printf '\\007' | dd bs=1 seek={place} conv=notrunc status=none of="


# a frame of six bodies without a wall: 104 bytes of header, then id, z, vz, fz of each
DAMAGES = {
    "sample interval": (byte(0), "other time steps"),
    "bodies": (byte(8), "damaged in sample 1"),
    "count": (byte(104 + 6 * 32 + 100), "damaged in sample 2"),
    "order": (byte(104 + 6), "another order"),
    "end": ("truncate -s -6 ", "ends in sample 301 of 301"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_dumps_of_the_real_engine(
    damage: str, stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path
) -> None:
    need("liggghts")
    command, words = DAMAGES[damage]
    real = subprocess.run(["which", "liggghts"], capture_output=True, text=True, check=True).stdout.strip()
    stand_in("liggghts", f'{real} "$@" || exit 1\n[ ! -e chain.bin ] || {command}chain.bin\n')
    status, reason = failing_run(scene_file(wall=""), "liggghts", tmp_path / "runs")
    assert status == "failed"
    assert words in reason


def test_a_damaged_folder_is_run_again(scene_file: SceneWriter, tmp_path: Path) -> None:
    case = case_of(scene_file())
    first = run_case(case, "verlet", tmp_path / "runs")
    (first.folder / "forces.parquet").unlink()
    again = run_case(case, "verlet", tmp_path / "runs")
    assert again.done
    assert len(open_run(again.folder).trace.time_s) == 301


CRASHES = {
    "exit code": ('echo "ERROR: Illegal pair_style command (./src/input.cpp:42)"; exit 1', "Illegal pair_style"),
    "a signal": ("kill -SEGV $$", "killed by signal 11"),
    "bytes that are no text": ("printf 'ERROR: \\377\\376 broken'; exit 3", "exit code 3: ERROR: \ufffd\ufffd broken"),
    "no output": ("exit 0", "no output"),
    "no word": ("exit 7", "exit code 7: no output"),
    "words of a library": ('echo broken; echo "[hwloc/linux] no topology" >&2; exit 7', "exit code 7: broken"),
    "half a dump": ("head -c 200 /dev/zero > chain.bin", "output ends in sample 1 of 301"),
}


@pytest.mark.parametrize("name", CRASHES)
def test_crashes(name: str, stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path) -> None:
    script, words = CRASHES[name]
    stand_in("liggghts", f'case "$*" in *-help*) echo "Version stand-in,"; exit;; esac\n{script}')
    status, reason = failing_run(scene_file(), "liggghts", tmp_path / "runs")
    assert status == "failed"
    assert words in reason


@pytest.mark.parametrize("own_group", [False, True])
def test_a_hanging_engine_is_killed_and_its_children_with_it(
    own_group: bool, stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path
) -> None:
    group = f'{sys.executable} -c \'import os; os.setpgid(0, 0); os.execlp("sleep", "sleep", "987")\''  # as of mpirun
    script = 'case "$*" in *--version*) echo "Yade version: 0"; exit;; esac\n{} & echo $! > "$0.pid"; wait'
    stand_in("yade", script.format(group if own_group else "sleep 987"))
    status, reason = failing_run(scene_file(), "yade", tmp_path / "runs", limit_s=1)
    assert (status, reason) == ("timeout", "killed at the time limit of 1 s")
    child = int((tmp_path / "bin" / "yade.pid").read_text())
    assert ends(child, within_s=30)


def ends(process: int, within_s: float) -> bool:
    """True if a killed process has ended; waits for it."""
    deadline = time.monotonic() + within_s
    while running(process):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


def running(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rsplit(") ", 1)[1][0]
    except FileNotFoundError:
        return False
    return state != "Z"


def test_one_failure_leaves_the_others_alone(stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path) -> None:
    stand_in("liggghts", "echo 'ERROR: out of order'; exit 1")
    words = ("--engine", "liggghts", "--engine", "verlet")
    done = beads("run", scene_file(), "--runs", tmp_path / "runs", *words)
    assert done.returncode == 1
    failed, good = done.stdout.split()
    assert json.loads((Path(failed) / "run.json").read_text())["status"] == "failed"
    assert json.loads((Path(good) / "run.json").read_text())["status"] == "done"
    assert done.stderr.strip() == "scene: liggghts failed: exit code 1: ERROR: out of order"


MPIRUN = """mpirun has detected an attempt to run as root.

Running as root is *strongly* discouraged.
We reiterate our advice against doing so - please proceed at your own risk."""


def test_a_failed_start_is_reported_from_its_first_line(
    stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path
) -> None:
    stand_in("liggghts", f"echo '{MPIRUN}' >&2; exit 1")
    done = beads("run", scene_file(), "--runs", tmp_path / "runs", "--engine", "liggghts")
    start = "scene: liggghts failed: exit code 1: mpirun has detected an attempt to run as root. Running as root"
    assert done.stderr.startswith(start)
    assert done.stderr.endswith(f"(see {done.stdout.strip()}/stderr.txt)\n")


def test_an_engine_that_cannot_start(scene_file: SceneWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "bin"
    folder.mkdir()
    (folder / "yade").write_text("#!/no/such/interpreter\n")
    (folder / "yade").chmod(0o755)
    monkeypatch.setenv("PATH", str(folder))
    status, reason = failing_run(scene_file(), "yade", tmp_path / "runs")
    assert status == "failed"
    assert "cannot start" in reason


@pytest.mark.parametrize("damaged", [b"", b"PK\x03\x04 torn", b"\x93NUMPY"])
def test_damaged_arrays(damaged: bytes, tmp_path: Path) -> None:
    (tmp_path / "chain.npz").write_bytes(damaged)
    with pytest.raises(RunError, match="damaged"):
        load_engine("yade").read(case_of("fig4"), tmp_path)


def test_complex_or_misshapen_arrays_are_no_output(tmp_path: Path) -> None:
    case = case_of("fig4")
    np.savez(tmp_path / "chain.npz", force=np.zeros((801, 22)) * 1j, height=np.zeros(1), velocity=np.zeros(1))
    with pytest.raises(RunError, match="damaged"):
        load_engine("yade").read(case, tmp_path)
    np.save(tmp_path / "chain.npy", np.zeros(3))
    (tmp_path / "chain.npy").rename(tmp_path / "chain.npz")
    with pytest.raises(RunError, match="damaged"):
        load_engine("yade").read(case, tmp_path)


def test_a_failed_run_is_tried_again(stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path) -> None:
    need("liggghts")
    case, runs = case_of(scene_file()), tmp_path / "runs"
    real = subprocess.run(["which", "liggghts"], capture_output=True, text=True, check=True).stdout.strip()
    stand_in("liggghts", f'[ -e chain.in ] && [ ! -e {tmp_path}/repaired ] && exit 1\nexec {real} "$@"')
    assert run_case(case, "liggghts", runs).record.status == "failed"
    (tmp_path / "repaired").touch()
    assert run_case(case, "liggghts", runs).done
    assert len([folder for folder in (runs / "liggghts").iterdir() if folder.is_dir()]) == 1


def test_a_missing_engine(scene_file: SceneWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bare = tmp_path / "bare"
    bare.mkdir()
    for tool in ("env", "git"):
        (bare / tool).symlink_to(f"/usr/bin/{tool}")
    asked = beads_process("run", scene_file(), "--runs", tmp_path / "runs", "--engine", "yade", PATH=str(bare))
    assert asked.returncode == 1
    assert "yade: not installed" in asked.stderr
    unasked = beads_process("run", scene_file(), "--runs", tmp_path / "runs", PATH=str(bare))
    assert unasked.returncode == 0
    monkeypatch.setenv("PATH", str(bare))
    absent = missing_codes()  # all but one that is next to the interpreter
    assert f"not run, not installed ({len(absent)}): {', '.join(absent)}" in unasked.stderr
    assert len(unasked.stdout.split()) == 2


def test_a_killed_driver_leaves_nothing_that_looks_done(
    stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path
) -> None:
    stand_in(
        "yade", 'case "$*" in *--version*) echo "Yade version: 0"; exit;; esac\necho $$ > "$0.pid"; exec sleep 654'
    )
    runs, note = tmp_path / "runs", tmp_path / "bin" / "yade.pid"
    words = [*BEADS, "run", scene_file(), "--engine", "yade", "--runs", runs]
    driver = subprocess.Popen(list(map(str, words)), stdout=subprocess.PIPE)
    for _ in range(200):
        if note.exists() and note.read_text():
            break
        time.sleep(0.05)
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    engine = int(note.read_text())
    assert ends(engine, within_s=30)
    assert not [folder for folder in (runs / "yade").iterdir() if folder.name[0] != "."]
    stand_in("yade", "exit 1")
    failing_run(scene_file(), "yade", runs)
    leftovers = [entry.name for entry in (runs / "yade").iterdir() if entry.is_dir() and entry.name[0] == "."]
    assert not leftovers


@pytest.mark.long
def test_two_simultaneous_runs_do_not_harm_each_other(scene_file: SceneWriter, tmp_path: Path) -> None:
    words = [*BEADS, "run", scene_file(), "--engine", "verlet", "--runs", tmp_path / "runs"]
    both = [subprocess.Popen(list(map(str, words)), stdout=subprocess.PIPE, text=True) for _ in range(2)]
    folders = {process.communicate(timeout=100)[0].strip() for process in both}
    assert [process.returncode for process in both] == [0, 0]
    assert len(folders) == 1
    assert len(open_run(Path(folders.pop())).trace.time_s) == 301


def test_help_loads_nothing_heavy() -> None:
    probe = """import sys
from validation.commands.beads import BEADS
BEADS.get_help(BEADS.make_context("beads", ["run"]))
print(sorted({"numpy", "pandas", "pint", "pydantic", "scipy"} & set(sys.modules)))"""
    assert subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True).stdout == "[]\n"
