"""Tests of processes: their end with everything that they have started, their folders, their memory."""

import fcntl
import os
import platform
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import TextIO

import pytest

from drivers.base.errors import InputError
from drivers.base.processes import ABANDONED_S, LOCK, PLACE, STDERR, private_temporary_folder, run_command, workplace

# a signal comes when a slow launcher runs a command that makes its folder again and again, as Open MPI does
LEFT_AT_A_START = '''
import signal, subprocess, sys, time
from pathlib import Path
from typing import TextIO
from drivers.base import processes
AGAIN = """
import os, sys
while True:
    try:
        os.makedirs(sys.argv[1] + "/made", exist_ok=True)
    except OSError:
        pass
"""
real = subprocess.Popen
def interrupted(*words, **options):
    process = real(*words, **options)
    while not [*Path(sys.argv[1]).glob("*/made")]:
        time.sleep(0.01)
    process.send_signal(signal.SIGSTOP)
    real(("sh", "-c", f"sleep 0.3; kill -CONT {process.pid}"))
    signal.raise_signal(signal.SIGTERM)
    return process
signal.signal(signal.SIGTERM, signal.default_int_handler)
subprocess.Popen = interrupted
try:
    with processes.workplace(Path(sys.argv[1])) as place:
        processes.run_command(("setsid", "--fork", "--wait", sys.executable, "-c", AGAIN, str(place)), place, 60.0)
except KeyboardInterrupt:
    sys.exit(1)
'''


def test_a_process_that_is_interrupted_waits_for_what_it_starts(tmp_path: Path) -> None:
    words = [sys.executable, "-c", LEFT_AT_A_START, str(tmp_path)]
    done = subprocess.run(words, capture_output=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (1, b"")
    assert not [*tmp_path.iterdir()]


def test_memory_and_time_are_those_of_the_command(tmp_path: Path) -> None:
    """With its children; not the memory of this process, which starts it."""
    held = bytes(300_000_000)
    small = run_command(("true",), tmp_path, 60.0)
    assert 0 < small.memory_bytes < 30_000_000 < len(held)
    code = "import time; held = b'1' * 200_000_000\nwhile time.process_time() < 0.5: pass"
    large = run_command(("sh", "-c", f'{sys.executable} -c "{code}"; exit 3'), tmp_path, 60.0)
    assert large.code == 3
    assert large.memory_bytes == pytest.approx(210_000_000, rel=0.1)
    assert 0.49 < large.cpu_s < large.wall_s


def test_a_command_hears_of_closed_pipes(tmp_path: Path) -> None:
    """Python ignores that signal, and so would its children."""
    assert run_command(("sh", "-c", "yes | head -n 1"), tmp_path, 60.0).code == 0
    assert (tmp_path / STDERR).read_text() == ""


def test_nobody_waits_for_a_killed_launcher(tmp_path: Path) -> None:
    ended = run_command(("sh", "-c", "kill -9 $PPID; sleep 20"), tmp_path, 60.0)
    assert ended.code == -9
    assert ended.wall_s < 10


def test_only_abandoned_workplaces_of_this_user_are_removed(tmp_path: Path) -> None:
    home, elsewhere = tmp_path / "home", tmp_path / "elsewhere"
    made = {}
    for name, machine, age_s in (
        ("dead", platform.node(), 0.0),
        ("mine", platform.node(), 0.0),
        ("far", "another", 0.9 * ABANDONED_S),
        ("old", "another", 1.1 * ABANDONED_S),
        ("linked", platform.node(), 0.0),
    ):
        made[name] = home / f"{PLACE}{name}@{machine}"
        made[name].mkdir(parents=True)
        (made[name] / LOCK).touch()
        for path in (made[name] / LOCK, made[name]):
            os.utime(path, (time.time() - age_s,) * 2)
    shutil.move(made["linked"], elsewhere)
    made["linked"].symlink_to(elsewhere)
    if os.getuid() == 0:
        os.chown(made["mine"], 1, 1)
    else:
        shutil.rmtree(made["mine"])
    with workplace(home) as place, workplace(home):
        assert place.is_dir()
        assert place.stat().st_mode & 0o777 == 0o700
        assert not made["dead"].exists()
        assert not made["old"].exists()
        assert made["far"].exists()
        assert (made["linked"] / LOCK).exists()
        assert made["mine"].exists() is (os.getuid() == 0)
    assert not place.exists()


def test_a_workplace_is_not_removed_before_it_is_locked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lock = fcntl.flock

    def late(file: TextIO, how: int) -> None:
        monkeypatch.setattr("fcntl.flock", lock)
        with workplace(tmp_path):  # of another process
            lock(file, how)

    monkeypatch.setattr("fcntl.flock", late)
    with workplace(tmp_path) as place:
        assert place.is_dir()


@pytest.mark.parametrize("mode", [0o777, 0o1777, 0o755])
def test_temporary_files_lie_where_nobody_replaces_them(
    mode: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    tmp_path.chmod(mode)
    if mode != 0o777:
        assert private_temporary_folder() == tmp_path
        if os.getuid() == 0:
            os.chown(tmp_path, 1, 1)
        else:
            return
    with pytest.raises(InputError, match=r"^TMPDIR=.*: found a folder in which others can replace files; allowed: "):
        private_temporary_folder()
