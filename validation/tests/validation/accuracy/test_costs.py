"""Costs of engines without an entry in the table: measured once for each build, and never infinite."""

import sys
from math import isfinite
from pathlib import Path

import pytest

from drivers.base.errors import RunError
from drivers.engines import codes, engine_names, load_engine
from validation.accuracy import costs
from validation.accuracy.costs import Cost, cost_on
from validation.tests.engine.candidate import MINE
from validation.tests.helpers.scenes import EnginesWriter


@pytest.fixture
def unlisted(engines_file: EnginesWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Adds an engine ``mine`` without a known cost and one with a known adapter; returns the adapter of ``mine``."""
    (tmp_path / "mine.py").write_text(MINE)
    absent = '[absent]\nadapter = "mine.py"\ncommand = "no-such-program"\n'
    engines_file(
        f'[mine]\nadapter = "mine.py"\ncommand = "{sys.executable}"\n[other]\nadapter = "{codes()[0]}"\n{absent}'
    )
    costs._measured.cache_clear()
    monkeypatch.setattr(costs, "REPEATS", 1)
    monkeypatch.setattr(costs, "LOOP_S", 0.01)
    return tmp_path / "mine.py"


def test_a_cost_is_measured_once_for_each_build(
    unlisted: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    measured = cost_on("mine")
    assert all(isfinite(each) and each > 0 for each in (measured.start_s, measured.step_ns, measured.sample_ns))
    assert "mine: no entry in inputs/costs.toml; cost measured and cached" in capsys.readouterr().err
    other = Cost(1.0, 2.0, 3.0)
    monkeypatch.setattr(costs, "measure", lambda engine, build: other)
    costs._measured.cache_clear()  # as in another process
    assert cost_on("mine") == measured
    unlisted.write_text(f"{MINE}\n# another build\n")
    assert cost_on("mine") == other


@pytest.mark.usefixtures("unlisted")
def test_no_cost_is_infinite(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> Cost:
        raise RunError("out of order")

    monkeypatch.setattr(costs, "measure", fails)
    dearest = max((cost_on(name) for name in engine_names()), key=lambda cost: cost.step_ns)
    assert cost_on("mine") == cost_on("absent") == dearest
    assert cost_on("other") == cost_on(load_engine("other").entry.adapter)
