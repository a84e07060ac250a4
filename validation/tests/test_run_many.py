"""Many runs side by side."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from drivers.run_many import run_many
from validation.tests.conftest import SceneWriter, case_of, need

SLOW = """
import sys
from drivers.case import build_case
from drivers.read_scene import read_scene
from drivers.run_many import run_many
from drivers.cli import run_main
from pathlib import Path
def main():
    settings = [(f"striker.speed={v} m/s", "run.time_step=0.1 ns") for v in (1, 2, 3, 4)]
    cases = [build_case(read_scene(sys.argv[1], each)) for each in settings]
    run_many([(case, "verlet") for case in cases], Path(sys.argv[2]))
    return 0
run_main(main)
"""


def test_order_is_kept_and_equal_decks_run_once(scene_file: SceneWriter, tmp_path: Path) -> None:
    path = scene_file()
    cases = [case_of(path, f"striker.speed={speed} m/s") for speed in (3, 1, 2, 1)]
    ended = run_many([(case, "verlet") for case in cases], tmp_path)
    speeds = [each.record.scene["striker"]["speed"] for each in ended]
    assert speeds == [3, 1, 2, 1]
    assert ended[1].folder == ended[3].folder
    assert len(list((tmp_path / "verlet").glob("[!.]*"))) == 3


def test_a_failed_run_leaves_the_others_alone(scene_file: SceneWriter, tmp_path: Path) -> None:
    path = scene_file()
    good, unstable = case_of(path), case_of(path, "run.time_step=50 us", "run.sample_interval=50 us")
    ended = run_many([(unstable, "verlet"), (good, "verlet")], tmp_path)
    assert [each.done for each in ended] == [False, True]


def test_an_interrupt_ends_all_and_leaves_no_folder(scene_file: SceneWriter, tmp_path: Path) -> None:
    for request in (signal.SIGINT, signal.SIGTERM):
        runs = tmp_path / request.name
        words = (sys.executable, "-c", SLOW, str(scene_file(duration="20 ms")), str(runs))
        process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
        home = runs / "verlet"
        until = time.monotonic() + 60
        while time.monotonic() < until and not (home.exists() and len(list(home.glob(".*.*/chain.json"))) >= 1):
            time.sleep(0.05)
        time.sleep(0.3)
        process.send_signal(request)
        _, said = process.communicate(timeout=60)
        assert process.returncode == 130
        assert said.strip() == "interrupted"
        assert not [path for path in home.iterdir() if path.is_dir()]
        running = subprocess.run(["pgrep", "-f", str(runs)], capture_output=True, text=True, check=False).stdout.split()
        assert not [pid for pid in running if int(pid) != os.getpid()]


def test_codes_run_side_by_side(scene_file: SceneWriter, tmp_path: Path) -> None:
    need("liggghts")
    cases = [case_of(scene_file(), f"striker.speed={speed} m/s") for speed in (1, 2, 3)]
    ended = run_many([(case, "liggghts") for case in cases], tmp_path)
    assert all(each.done for each in ended)
