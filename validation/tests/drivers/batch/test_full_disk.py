"""Tests of full disks, which fail no case."""

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.batch.store import Store
from validation.tests.drivers.batch.test_batch import batch, table
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import SPEEDS, SceneWriter, StandIn, StudyWriter


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """File system of three megabytes."""
    place = tmp_path / "disk"
    place.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", place], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("mounting a small file system needs more rights")
    yield place
    subprocess.run(["umount", "-l", place], check=True)


@pytest.mark.long
@pytest.mark.parametrize("engine", ["verlet", "liggghts"])
def test_a_full_disk_ends_the_batch(engine: str, study_file: StudyWriter, small_disk: Path) -> None:
    need(engine)
    path, runs = study_file(SPEEDS.format(20), engine), small_disk / "runs"
    free = shutil.disk_usage(small_disk).free
    (small_disk / "ballast").write_bytes(b"\0" * (free - 60_000))
    done = batch(path, runs)
    assert done.returncode == 1
    assert "No space left on device" in done.stderr
    assert "Traceback" not in done.stderr
    assert not [row for row in Store(runs).refresh() if not row.done]
    (small_disk / "ballast").unlink()
    again = batch(path, runs)
    assert again.returncode == 0, again.stderr
    assert set(table(runs)["status"]) == {"done"}


def test_a_disk_that_temporary_files_fill_during_a_run_counts_as_full(
    stand_in: StandIn, scene_file: SceneWriter, small_disk: Path
) -> None:
    """As those of Open MPI, which are gone when the code has ended."""
    need("liggghts")
    took = small_disk / "temporary"
    stand_in(
        "liggghts", f'head -c 2900k /dev/zero > {took}; {shutil.which("liggghts")} "$@"; code=$?; rm {took}; exit $code'
    )
    done = beads("run", scene_file(duration="0.5 ms"), "--engine", "liggghts", "--runs", small_disk / "runs")
    assert done.returncode == 1
    assert "No space left on device" in done.stderr
