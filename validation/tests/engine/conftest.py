"""Fixtures of the tests of an engine."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from drivers.engines import VERLET, engine_names, load_engine
from drivers.run.build import build_of
from drivers.run.compute import Session
from validation.tests.engine.candidate import STAND_INS, Candidate
from validation.tests.helpers.runs import need


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Runs the tests on the engines of ``--engine``, else on all: only ``verlet`` if long tests are left out."""
    if "candidate" in metafunc.fixturenames:
        names = metafunc.config.getoption("engine")
        shipped = [pytest.param(name, marks=() if name == VERLET else pytest.mark.long) for name in engine_names()]
        metafunc.parametrize("candidate", names or shipped, indirect=True, scope="session")


@pytest.fixture(scope="session")
def candidate(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Candidate]:
    """Engine under test with its build, a folder and a server."""
    if request.param not in STAND_INS:
        need(request.param)
    engine, folder = STAND_INS.get(request.param) or load_engine(request.param), tmp_path_factory.mktemp("engine")
    build = build_of(engine)
    runs = Path(folder, "runs")
    runs.mkdir()
    with closing(Session(engine, build.command, folder / "session")) as session:
        yield Candidate(engine, build, runs, session)
