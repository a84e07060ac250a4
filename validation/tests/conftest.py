"""Fixtures and options of all tests."""

import os
import signal
import uuid
from pathlib import Path

import pytest

from drivers.base import paths
from drivers.engines import codes
from validation.tests.helpers.scenes import BASE, STRIKER, WALL, EnginesWriter, SceneWriter, StandIn, StudyWriter


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of the tests."""
    parser.addoption("--update-decks", action="store_true", help="write the deck snapshots again")
    parser.addoption("--engine", action="append", default=[], help="run the tests of an engine on this entry alone")


def pytest_configure(config: pytest.Config) -> None:
    """With ``--engine`` long tests run too; else tests use the engines of the package and entries of their own."""
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores it, and so its children
    if config.getoption("engine"):
        config.option.markexpr = ""
    else:
        os.environ.pop(paths.ENGINES_VARIABLE, None)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """With ``--engine`` only tests of an engine run."""
    if config.getoption("engine"):
        items[:] = [item for item in items if "candidate" in getattr(item, "fixturenames", ())]


@pytest.fixture(autouse=True)
def _nothing_kept(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Gives each test a cache of its own, since tests replace code."""
    monkeypatch.setattr(paths, "CACHE", tmp_path_factory.getbasetemp() / f"kept-{uuid.uuid4().hex}")


@pytest.fixture
def scene_file(tmp_path: Path) -> SceneWriter:
    """Writes a small scene of five beads on a brass wall, struck by a sixth; any part can be replaced."""

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


@pytest.fixture
def engines_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> EnginesWriter:
    """Writes entries of engines for the test, as if given by ``--engines``."""

    def write(text: str) -> Path:
        path = tmp_path / "own-engines.toml"
        path.write_text(text)
        monkeypatch.setenv(paths.ENGINES_VARIABLE, str(path))
        return path

    return write


@pytest.fixture
def no_codes(engines_file: EnginesWriter) -> None:
    """Makes all codes missing, also those beside the interpreter."""
    engines_file("".join(f'[{code}]\ncommand = "{code}-is-nowhere"\n' for code in codes()))


@pytest.fixture(scope="session")
def shared_runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of runs for the whole session, so that a case runs once."""
    return tmp_path_factory.mktemp("runs")


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
