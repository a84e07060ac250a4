"""Tests of runs that fail: the engine's own words, damaged output, time limits and kills."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from shutil import which

import numpy as np
import psutil
import pytest

from drivers.base.errors import RunError
from drivers.engines import load_engine, missing_codes
from drivers.run.compute import compute
from drivers.run.run import run_case
from validation.tests.helpers.commands import BEADS, beads
from validation.tests.helpers.runs import failing_run, need
from validation.tests.helpers.scenes import SceneWriter, StandIn, case_of

MPIRUN = """mpirun has detected an attempt to run as root.

Running as root is *strongly* discouraged.
We reiterate our advice against doing so - please proceed at your own risk."""
CRASHES = {
    "exit code": ('echo "ERROR: Illegal pair_style command (./src/input.cpp:42)"; exit 1', "Illegal pair_style"),
    "a signal": ("kill -SEGV $$", "killed by signal 11"),
    "bytes that are no text": ("printf 'ERROR: \\377\\376 broken'; exit 3", "exit code 3: ERROR: \ufffd\ufffd broken"),
    "no output": ("exit 0", "no output"),
    "no word": ("exit 7", "exit code 7: no output"),
    "words of a library": ('echo broken; echo "[hwloc/linux] no topology" >&2; exit 7', "exit code 7: broken"),
    "a failed start": (
        f"echo '{MPIRUN}' >&2; exit 1",
        "exit code 1: mpirun has detected an attempt to run as root. Run",
    ),
    "half a dump": ("head -c 200 /dev/zero > chain.bin", "output ends in sample 1 of 301"),
}


@pytest.mark.parametrize("crash", CRASHES)
def test_crash_is_reported_in_the_words_of_the_engine(
    crash: str, stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path
) -> None:
    script, words = CRASHES[crash]
    stand_in("liggghts", f'case "$*" in *-help*) echo "Version stand-in,"; exit;; esac\n{script}')
    status, reason = failing_run(scene_file(), "liggghts", tmp_path / "runs")
    assert status == "failed"
    assert words in reason


def test_damage_of_a_dump_is_named(scene_file: SceneWriter, tmp_path: Path) -> None:
    """A frame of six bodies without a wall has a header of 104 bytes, then id, z, vz and fz of each body."""
    need("liggghts")
    case, dump = case_of(scene_file(wall="")), tmp_path / "chain.bin"
    compute(case, "liggghts", folder=tmp_path, by_hand=True)
    whole = dump.read_bytes()
    for place, words in (
        (0, "other time steps"),
        (8, "damaged in sample 1"),
        (104 + 6 * 32 + 100, "damaged in sample 2"),
        (104 + 6, "another order"),
        (len(whole) - 6, "ends in sample 301 of 301"),
    ):
        rest = whole[place + 1 :] if place + 6 < len(whole) else b""
        dump.write_bytes(whole[:place] + bytes([7] * bool(rest)) + rest)
        with pytest.raises(RunError, match=words):
            load_engine("liggghts").read(case, tmp_path)


def test_damaged_arrays_are_no_output(tmp_path: Path) -> None:
    case, output = case_of("fig4"), tmp_path / "chain.npz"
    np.save(tmp_path / "flat.npy", np.zeros(3))
    np.savez(tmp_path / "complex.npz", force=np.zeros((801, 22)) * 1j, height=np.zeros(1), velocity=np.zeros(1))
    arrays = [(tmp_path / name).read_bytes() for name in ("flat.npy", "complex.npz")]
    for content in (b"", b"PK\x03\x04 torn", b"\x93NUMPY", *arrays):
        output.write_bytes(content)
        with pytest.raises(RunError, match="damaged"):
            load_engine("yade").read(case, tmp_path)


def test_hanging_engine_is_killed_with_its_children(stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path) -> None:
    """Also a child in a process group of its own, as of mpirun."""
    group = f'{sys.executable} -c \'import os; os.setpgid(0, 0); os.execlp("sleep", "sleep", "987")\''
    version = 'case "$*" in *--version*) echo "Yade version: 0"; exit;; esac'
    stand_in("yade", f'{version}\nsleep 987 & echo $! > "$0.pid"\n{group} & echo $! >> "$0.pid"; wait')
    status, reason = failing_run(scene_file(), "yade", tmp_path / "runs", limit_s=1)
    assert (status, reason) == ("timeout", "killed at the time limit of 1 s")
    children = (tmp_path / "bin" / "yade.pid").read_text().split()
    assert len(children) == 2
    assert all(ends(int(child)) for child in children)


def ends(process: int) -> bool:
    """True if a killed process ends within half a minute."""
    try:
        psutil.Process(process).wait(30)
    except psutil.NoSuchProcess:
        return True
    except psutil.TimeoutExpired:
        return False
    return True


def test_one_failure_leaves_the_other_engines_alone(stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path) -> None:
    stand_in("liggghts", "echo 'ERROR: out of order'; exit 1")
    words = ("--engine", "liggghts", "--engine", "verlet")
    done = beads("run", scene_file(), "--runs", tmp_path / "runs", *words)
    assert done.returncode == 1
    failed, good = done.stdout.split()
    assert json.loads((Path(failed) / "run.json").read_text())["status"] == "failed"
    assert json.loads((Path(good) / "run.json").read_text())["status"] == "done"
    assert done.stderr.strip() == "scene: liggghts failed: exit code 1: ERROR: out of order"


def test_engine_that_cannot_start_fails(
    stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stand_in("yade", "")
    (tmp_path / "bin" / "yade").write_text("#!/no/such/interpreter\n")
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    status, reason = failing_run(scene_file(), "yade", tmp_path / "runs")
    assert status == "failed"
    assert "cannot start" in reason


def test_failed_run_is_tried_again(stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path) -> None:
    need("liggghts")
    case, runs = case_of(scene_file()), tmp_path / "runs"
    stand_in("liggghts", f'[ -e chain.in ] && [ ! -e {tmp_path}/repaired ] && exit 1\nexec {which("liggghts")} "$@"')
    assert run_case(case, "liggghts", runs).record.status == "failed"
    (tmp_path / "repaired").touch()
    assert run_case(case, "liggghts", runs).done
    assert len([folder for folder in (runs / "liggghts").iterdir() if folder.is_dir()]) == 1


def test_missing_engine_fails_if_asked_for(
    scene_file: SceneWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, runs = scene_file(duration="20 us"), tmp_path / "runs"
    monkeypatch.setenv("PATH", str(tmp_path))
    absent = missing_codes()  # all but one that is next to the interpreter
    asked = beads("run", scene, "--runs", runs, "--engine", "yade")
    assert asked.returncode == 1
    assert "yade: not installed" in asked.stderr
    unasked = beads("run", scene, "--runs", runs)
    assert unasked.returncode == 0
    assert f"not run, not installed ({len(absent)}): {', '.join(absent)}" in unasked.stderr
    assert len(unasked.stdout.split()) == 2


def test_killed_driver_leaves_no_folder(stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path) -> None:
    """The engine ends with it, and the next run removes what is left."""
    version = 'case "$*" in *--version*) echo "Yade version: 0"; exit;; esac'
    stand_in("yade", f'{version}\necho $$ > "$0.pid"; exec sleep 654')
    runs, note = tmp_path / "runs", tmp_path / "bin" / "yade.pid"
    words = [*BEADS, "run", scene_file(), "--engine", "yade", "--runs", runs]
    driver = subprocess.Popen(list(map(str, words)), stdout=subprocess.PIPE)
    until = time.monotonic() + 60
    while not (note.exists() and note.read_text()) and time.monotonic() < until:
        time.sleep(0.05)
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    assert ends(int(note.read_text()))
    assert not [folder for folder in (runs / "yade").iterdir() if folder.name[0] != "."]
    stand_in("yade", "exit 1")
    failing_run(scene_file(), "yade", runs)
    assert not [entry for entry in (runs / "yade").iterdir() if entry.is_dir() and entry.name[0] == "."]
