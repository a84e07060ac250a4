"""Tests of results kept on disk: equal to computed ones, or ignored; and of what commands need not load."""

import subprocess
import sys
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import pytest

from drivers.base import cache as module
from drivers.base import paths
from drivers.base.cache import cached
from drivers.base.processes import run_command
from validation.tests.helpers.commands import BEADS


@pytest.fixture(autouse=True)
def _kept_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(paths, "CACHE", tmp_path / "kept")
    _forget()
    yield
    _forget()


def _forget() -> None:
    """Digests are computed once in a process."""
    module._program.cache_clear()
    module.digest_of_sources.cache_clear()


def test_altered_entry_is_computed_again(capsys: pytest.CaptureFixture[str]) -> None:
    """A factor of 0.002 in the place of 0.001 would give beads of twice the diameter."""
    assert cached(["mm", "m"], lambda: 0.001) == cached(["mm", "m"], lambda: 5.0) == 0.001
    (path,) = paths.CACHE.iterdir()
    cached(["other"], lambda: 2.0)
    (other,) = {*paths.CACHE.iterdir()} - {path}
    wrong = ("", "5", "null", "[1, 2]", "{}", "[" * 100_000, '{"a": NaN}')
    for content in (path.read_text().replace("0.001", "0.002"), other.read_text(), *wrong):
        path.write_text(content)
        assert cached(["mm", "m"], lambda: 0.001) == 0.001
        (line,) = capsys.readouterr().err.splitlines()
        assert path.name in line
        assert line.endswith("computed again")
        assert cached(["mm", "m"], lambda: 5.0) == 0.001
        assert not capsys.readouterr().err


def test_other_sources_and_inputs_compute_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paths, "ROOT", tmp_path)
    monkeypatch.setattr(paths, "INPUTS", tmp_path / "inputs")
    numbers = count()
    for number, name in enumerate(("validation/reference/law.py", "inputs/scenes/a.toml", "inputs/scenes/b.toml")):
        assert cached([], lambda: next(numbers)) == cached([], lambda: -1) == number
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("k = 1")
        _forget()
    assert cached([], lambda: next(numbers)) == 3


def test_without_a_writable_folder_results_are_computed() -> None:
    paths.CACHE.write_text("a file in the place of the folder")
    assert (cached([], lambda: 1), cached([], lambda: 2)) == (1, 2)


def test_oldest_files_are_removed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_FILES", 3)
    for number in range(5):
        cached([number], lambda: 0)
    assert len([*paths.CACHE.iterdir()]) == 3


def test_finished_work_loads_no_integrator(tmp_path: Path) -> None:
    """Loading numba, scipy and pandas would take longer than the rest of this command."""
    words = ("compare", "two-spheres", "--engine", "verlet", "--runs", str(tmp_path / "runs"), "--allow-missing")
    command, printed = (sys.executable, "-X", "importtime", *BEADS[1:], *words), []
    for _ in range(2):
        assert run_command(command, tmp_path, 120.0, PYTHONPATH=str(paths.ROOT)).code == 0
        printed.append((tmp_path / "stdout.txt").read_text())
    assert printed[0] == printed[1] != ""
    loaded = {line.rpartition("|")[2].strip() for line in (tmp_path / "stderr.txt").read_text().splitlines()}
    assert "validation.accuracy.plan" in loaded
    assert not loaded & {"numba", "scipy", "pandas", "pyarrow", "pint"}


def test_help_loads_nothing_heavy() -> None:
    probe = """import sys
from validation.commands.beads import BEADS
BEADS.get_help(BEADS.make_context("beads", ["run"]))
print(sorted({"numpy", "pandas", "pint", "pydantic", "scipy"} & set(sys.modules)))"""
    assert subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True).stdout == "[]\n"
