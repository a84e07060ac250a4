"""What the tests share."""

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.case import Case, build_case
from drivers.engines import load_engine
from drivers.finished import FinishedRun, open_run
from drivers.read_scene import read_scene
from drivers.record import read_record
from drivers.run import run_case
from drivers.trace import Trace

BASE = """
[chain]
count = {count}
material = "ptfe"
diameter = "4.76 mm"
mass = "0.1226 g"
{chain}
{striker}
{wall}
[run]
duration = "{duration}"
sample_interval = "1 us"
time_step = "{step}"
"""
STRIKER = '[striker]\nmaterial = "ptfe"\ndiameter = "4.76 mm"\nspeed = "1 m/s"\n'
WALL = '[wall]\nmaterial = "brass"\n'

SPEEDS = '[[axis]]\nkey = "striker.speed"\nfrom = "0.5 m/s"\nto = "2 m/s"\ncount = {}\n'

SceneWriter = Callable[..., Path]
StandIn = Callable[[str, str], None]
StudyWriter = Callable[..., Path]


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--update-decks`` writes the deck snapshots anew."""
    parser.addoption("--update-decks", action="store_true", help="write the deck snapshots anew")


@pytest.fixture
def scene_file(tmp_path: Path) -> SceneWriter:
    """Writes a small scene: five beads on a brass wall, struck by a sixth; any part can be replaced."""

    def write(
        name: str = "scene",
        *,
        top: str = "",
        count: int = 5,
        chain: str = "",
        striker: str = STRIKER,
        wall: str = WALL,
        duration: str = "0.3 ms",
        step: str = "0.1 us",
    ) -> Path:
        path = tmp_path / f"{name}.toml"
        text = BASE.format(count=count, chain=chain, striker=striker, wall=wall, duration=duration, step=step)
        path.write_text(f"{top}\n{text}")
        return path

    return write


@pytest.fixture
def study_file(scene_file: SceneWriter, tmp_path: Path) -> StudyWriter:
    """Writes a study of the small scene with the axes and on the engines given."""
    scene_file()

    def write(axes: str, *engines: str, top: str = "") -> Path:
        path = tmp_path / "study.toml"
        names = ", ".join(f'"{name}"' for name in engines)
        path.write_text(f'scene = "scene.toml"\nengines = [{names}]\n{top}\n{axes}')
        return path

    return write


@pytest.fixture(scope="session")
def shared_runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A runs folder for the whole session, so that a case runs once."""
    return tmp_path_factory.mktemp("runs")


def need(engine: str) -> None:
    """Leaves a test out where its engine is not installed; in CI that is a failure."""
    if load_engine(engine).find() is None:
        if os.environ.get("CI"):
            pytest.fail(f"{engine} is not installed, and CI has to have it")
        pytest.skip(f"{engine} is not installed")


def finished(case: Case, engine: str, runs: Path) -> FinishedRun:
    """The run of a case on an engine, which has to be done."""
    need(engine)
    result = run_case(case, engine, runs)
    assert result.done, result.record.reason
    return open_run(result.folder)


def blown_up(trace: Trace, sample: int) -> Trace:
    """The same that blows up from that sample on: too large where the wave is, then no numbers."""
    force = trace.force_N.copy()
    force[sample:, np.argmax(force[sample])] = 1e200
    force[sample + 2 :] = np.nan
    return replace(trace, force_N=force)


def case_of(scene: str | Path, *settings: str) -> Case:
    """The case of a scene with settings."""
    return build_case(read_scene(scene, settings))


def command_line(*words: str | Path, **changes: str) -> subprocess.CompletedProcess[str]:
    """Runs ``python -m ...`` as a user does."""
    return subprocess.run(
        [sys.executable, "-m", *map(str, words)],
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
        env=os.environ | changes,
    )


@pytest.fixture
def stand_in(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StandIn:
    """Puts an executable of that name first on PATH."""

    def put(name: str, script: str) -> None:
        folder = tmp_path / "bin"
        folder.mkdir(exist_ok=True)
        (folder / name).write_text("#!/bin/sh\n" + script)
        (folder / name).chmod(0o755)
        monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")

    return put


def failing_run(scene: Path, engine: str, runs: Path, limit_s: float = 60) -> tuple[str, str]:
    """Status and reason of a run that must not be done, after checking what it leaves behind."""
    result = run_case(case_of(scene), engine, runs, limit_s=limit_s)
    stored = read_record(result.folder)
    assert stored is not None
    assert (stored.status, stored.reason) == (result.record.status, result.record.reason)
    assert not (result.folder / "forces.parquet").exists()
    assert [folder.name for folder in (runs / engine).iterdir() if folder.name[0] != "."] == [result.folder.name]
    return result.record.status, result.record.reason
