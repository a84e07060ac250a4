"""Costs of engines without an entry in the table: measured once for each build, and never infinite."""

import sys
from math import isfinite
from pathlib import Path

import pytest

from drivers.base.errors import RunError
from drivers.engines import codes, engine_names, load_engine
from validation.accuracy import costs
from validation.accuracy.costs import Cost, cost_on
from validation.accuracy.plan import auto_engines
from validation.tests.engine.candidate import MINE
from validation.tests.helpers.scenes import EnginesWriter, case_of


@pytest.fixture
def unlisted(engines_file: EnginesWriter, tmp_path: Path) -> Path:
    """Adds an engine ``mine`` without a known cost and one with a known adapter; returns the adapter of ``mine``."""
    (tmp_path / "mine.py").write_text(MINE)
    absent = '[absent]\nadapter = "mine.py"\ncommand = "no-such-program"\n'
    engines_file(
        f'[mine]\nadapter = "mine.py"\ncommand = "{sys.executable}"\n[other]\nadapter = "{codes()[0]}"\n{absent}'
    )
    costs._measured.cache_clear()
    return tmp_path / "mine.py"


def test_a_cost_is_measured_once_for_each_build(
    unlisted: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = cost_on("mine")
    assert all(isfinite(each) and each > 0 for each in (found.start_s, found.step_ns, found.sample_ns))
    assert "mine: no entry in inputs/costs.toml; cost measured and cached" in capsys.readouterr().err
    other = Cost(1.0, 2.0, 3.0)
    monkeypatch.setattr(costs, "measure", lambda engine, build: other)
    costs._measured.cache_clear()  # as in another process
    assert cost_on("mine") == found
    unlisted.write_text(f"{MINE}\n# another build\n")
    assert cost_on("mine") == other


def test_no_cost_is_infinite(unlisted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> Cost:
        raise RunError("out of order")

    monkeypatch.setattr(costs, "measure", fails)
    dearest = max((cost_on(name) for name in engine_names()), key=lambda cost: cost.step_ns)
    assert cost_on("mine") == cost_on("absent") == dearest
    assert cost_on("other") == cost_on(load_engine("other").entry.adapter)
    assert load_engine("absent").find() is None
    assert next(auto_engines(case_of("fig4"))) in engine_names()
