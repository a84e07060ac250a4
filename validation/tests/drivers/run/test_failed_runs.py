"""Tests of runs that fail: the engine's own words, time limits, engines that are missing or cannot start."""

import json
import platform
import re
import shutil
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest

from drivers.base.errors import RunError
from drivers.base.processes import LOCK, PLACE
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import Trace
from drivers.engines import codes, load_engine
from drivers.run.run import run_case
from drivers.run.scheme import checked, compared
from validation.tests.helpers.commands import beads
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


def test_hanging_engine_is_killed_with_its_children(stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path) -> None:
    """Also a child in a session of its own, as the daemon of Open MPI."""
    version = 'case "$*" in *--version*) echo "Yade version: 0"; exit;; esac'
    stand_in("yade", f'{version}\nsleep 987 & echo $! > "$0.pid"\nsetsid sleep 987 & echo $! >> "$0.pid"; wait')
    status, reason = failing_run(scene_file(), "yade", tmp_path / "runs", limit_s=1)
    assert (status, reason) == ("timeout", "killed at the time limit of 1 s")
    children = (tmp_path / "bin" / "yade.pid").read_text().split()
    assert len(children) == 2
    for child in children:
        with suppress(psutil.NoSuchProcess):
            psutil.Process(int(child)).wait(30)


def test_a_code_that_does_not_exit_after_its_time_loop_keeps_its_forces(
    stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path
) -> None:
    need("lammps")
    stand_in("lmp", f'{shutil.which("lmp")} "$@"; case "$*" in *-h*) ;; *) sleep 987; esac')
    case = case_of(scene_file())
    ended = run_case(case, "lammps", tmp_path / "runs", limit_s=5)
    assert ended.record.status == "timeout"
    hung = r"the time loop ended after \S+ s, but the program did not exit; killed at the time limit of 5 s"
    assert re.fullmatch(hung, ended.record.reason)
    assert len(ended.trace.time_s) == case.scene.samples


def test_engine_that_cannot_start_leaves_the_others_alone(
    stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stand_in("yade", "")
    (tmp_path / "bin" / "yade").write_text("#!/no/such/interpreter\n")
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    done = beads("run", scene_file(), "--runs", tmp_path / "runs", "--engine", "yade", "--engine", "verlet")
    assert done.returncode == 1
    records = [json.loads((Path(folder) / "run.json").read_text()) for folder in done.stdout.split()]
    assert {record["engine"]: record["status"] for record in records} == {"yade": "failed", "verlet": "done"}
    assert re.fullmatch(r"scene: yade failed: (exit code 1: )?cannot start: .*\n", done.stderr)


def test_failed_run_is_tried_again_and_replaces_no_finished_one(scene_file: SceneWriter, tmp_path: Path) -> None:
    """The next run removes what a killed process has left."""
    case, home = case_of(scene_file(duration="20 ms", step="2 ns")), tmp_path / "verlet"
    assert run_case(case, "verlet", tmp_path, limit_s=1e-6).record.status == "timeout"
    left = home / f"{PLACE}x@{platform.node()}"
    left.mkdir()
    (left / LOCK).touch()
    good = run_case(case, "verlet", tmp_path)
    assert good.done
    assert [folder for folder in home.iterdir() if folder.is_dir()] == [good.folder]
    bad = run_case(case, "verlet", tmp_path, rerun=True, limit_s=1e-6)
    assert bad.record.status == "timeout"
    assert bad.folder != good.folder
    assert run_case(case, "verlet", tmp_path).folder == good.folder


def test_missing_engine_fails_if_asked_for(no_codes: None, scene_file: SceneWriter, tmp_path: Path) -> None:
    scene, runs = scene_file(duration="20 us"), tmp_path / "runs"
    asked = beads("run", scene, "--runs", runs, "--engine", "yade")
    assert asked.returncode == 1
    assert "yade: not installed" in asked.stderr
    unasked = beads("run", scene, "--runs", runs)
    assert unasked.returncode == 0
    assert all(f"not run on {name}: not installed\n" in unasked.stderr for name in codes())
    assert len(unasked.stdout.split()) == 2


# scene, column of a trace, place in it, change there: added, or if None NaN; reason of the failure
Place = tuple[Any, ...]
FAULTS: dict[str, tuple[str, str, Place, float | None, str]] = {
    "not finite": ("fig4", "force_N", (5, 3), None, r"unstable at t = 5e-06 s: values are not finite"),
    "through a bead": ("fig4", "height_m", (4, 3), -6e-3, r"unstable at t = 4e-06 s: body 4 passed through body 3"),
    "through the wall": ("fig4", "height_m", (4, 0), -6e-3, r"unstable at .* body 1 passed through the wall"),
    "too deep": ("fig4", "force_N", (7, 3), 1e9, r"unstable at .* beads are pressed into each other by more than a"),
    "start": ("fig4", "height_m", (0, 3), 1e-9, r"body 4 starts with a height of .* m, the scene has "),
    "pressed": ("fig4", "force_N", (0, 3), 1e-6, r"departs from its scheme from the start: the force in contact 4 is "),
    "end of the tube": ("fig6d-tube", "height_m", (9, -1), -7e-4, r"at t = 9e-06 s the striker comes down to the end"),
    "force": ("fig4", "force_N", (8, 20), 1e-6, r"departs from its scheme from 8 µs, in the wave: the force in conta"),
    "before": ("fig4", "force_N", (8, 3), 1e-6, r"departs from its scheme from 8 µs, before any wave arrives: the f"),
    "energy": ("fig4", "total_energy_J", (8,), 1e-9, r"departs from its scheme from 8 µs: the energy is "),
    "momentum": ("fig4", "momentum_N_s", (8,), 1e-9, r"departs from its scheme from 8 µs: the momentum is "),
}


def changed(trace: Trace, column: str, place: Place, change: float | None) -> Trace:
    values = getattr(trace, column).copy()
    values[place] += np.nan if change is None else change
    return replace(trace, **{column: values})


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_of_a_trace_fails_the_run(fault: str) -> None:
    scene, column, place, change, reason = FAULTS[fault]
    case, engine = case_of(scene, "run.duration=20 us"), load_engine("liggghts")
    trace = verlet_of(case, engine.shear)
    compared(case, engine, checked(case, trace))
    with pytest.raises(RunError, match=f"^{reason}") as failed:
        compared(case, engine, checked(case, changed(trace, column, place, change)))
    assert failed.value.partial is not None


def test_the_first_of_several_faults_is_named() -> None:
    case = case_of("fig4", "run.duration=20 us")
    trace = changed(changed(verlet_of(case), "force_N", (4, 1), 1e9), "force_N", (7, 2), None)
    with pytest.raises(RunError, match=r"^unstable at t = 4e-06 s: beads are"):
        checked(case, trace)


@pytest.mark.parametrize(
    ("first_N", "said"), [(1.3e-13, ""), (1e-3, "beads are pressed into each other by more than a")]
)
def test_a_chain_without_a_wall_has_no_lowest_force_but_rounding(first_N: float, said: str) -> None:
    case = case_of("fig4", "wall=", "gravity=", "chain.sensors=[]", "run.duration=0.1 ms")
    right, engine = verlet_of(case), load_engine("verlet")
    force_N = right.force_N.copy()
    force_N[:, 0] = first_N
    with pytest.raises(RunError, match=said) if said else nullcontext():
        compared(case, engine, checked(case, replace(right, force_N=force_N)))
