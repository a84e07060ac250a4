"""The README of postproc: observables and columns are those of the code, commands parse, the Python examples run."""

import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from drivers.base import paths
from drivers.batch.study_table import COSTS
from drivers.run.run_folder import FORCES, SENSORS, STATE
from postproc.draw.overlay import misfit_table
from postproc.draw.style import pyplot
from postproc.read.observables import OBSERVABLES
from validation.tests.helpers.commands import beads
from validation.tests.helpers.readme import command_lines, parse
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import case_of

README = paths.ROOT / "postproc" / "README.md"
TEXT = README.read_text()
TUBE = ('run.record=["forces", "state"]', "run.duration=20 us")  # a scene with all columns


def names_in_table(lead: str) -> list[str]:
    """Names in backticks in the first column of the table that follows some words."""
    _, found, rest = TEXT.partition(lead)
    assert found, lead
    rows = re.search(r"\n\|.*\n\| --- .*\n((?:\|.*\n)+)", rest)
    assert rows
    return [name for row in rows[1].splitlines() for name in re.findall(r"`([^`]+)`", row.split(" | ")[0])]


def pattern_of(column: str) -> str:
    """Column of a run file with its number or gauge as a placeholder."""
    return re.sub(r"(?<=_)\d+(?=_)", "{j}", re.sub(r"^(bead_\d+|wall)_N$", "{gauge}_N", column))


@pytest.mark.parametrize("line", command_lines(README))
def test_commands_parse(line: str) -> None:
    parse(line)


def test_every_observable_is_defined_and_no_other() -> None:
    names = [f"{observable.pattern}{observable.ending}" for observable in OBSERVABLES]
    assert names_in_table("## Observables") == names


def test_every_column_of_a_run_is_described_and_no_other(shared_runs: Path) -> None:
    folder = finished(case_of("fig4-tube", *TUBE), "verlet", shared_runs).folder
    driven = finished(case_of("driven-steel", "run.duration=20 us"), "verlet", shared_runs).folder
    tables: dict[str, Callable[[Path], pd.DataFrame]] = {
        FORCES: pd.read_parquet,
        STATE: pd.read_parquet,
        SENSORS: pd.read_csv,
    }
    for file, read in tables.items():
        columns = {pattern_of(str(column)) for column in read(folder / file).columns}
        columns |= {name for name in pd.read_parquet(driven / FORCES).columns if file == FORCES and "drive" in name}
        assert set(names_in_table(f"`{file}`, one row per sample")) == columns, file


def test_columns_of_overlays_and_costs() -> None:
    assert names_in_table("`overlay-*.csv` with a row") == list(misfit_table([]).columns)
    assert all(f"`{name}`" in TEXT for name in COSTS)


def test_python_examples_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs, results = tmp_path / "runs", tmp_path / "results"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(paths, "RUNS", runs)
    monkeypatch.setattr(paths, "RESULTS", results)
    section = TEXT.partition("## Python\n")[2].partition("\n## ")[0]
    (study,) = re.findall(r"```toml\n(.*?)```", section, re.DOTALL)
    assert tomllib.loads(study)["engines"] == ["verlet"]
    Path("speeds.toml").write_text(study)
    done = beads("batch", "speeds.toml", "--runs", runs, "--results", results)
    assert done.returncode == 0, done.stderr
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", section, re.DOTALL):
        exec(compile(block, str(README), "exec"), names)
    pyplot().close("all")
    assert Path("gauges.png").stat().st_size > 1000
    power, errors = names["power"], names["errors"]
    assert isinstance(power, float)
    assert power == pytest.approx(1 / 6, abs=0.005)
    assert isinstance(errors, dict)
    assert errors["force"] <= 1e-4
    assert {folder.parent.name for folder in runs.glob("[!.]*/fig4-*")} == {"verlet"}
