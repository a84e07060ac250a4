"""Section of the page on measured traces, for scenes that have some."""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import SceneWriter

HEADING = "Measured and computed forces (reference)"
ENTRY = '[[measured]]\nfile = "shot.csv"\n'
QUOTED = "[[measured]]\nvalues = { wall_peak = '9 N' }\nerrors = { wall_peak = 0.1 }\n"


def report(scene: Path, runs: Path) -> tuple[int, str, str]:
    """Exit code, page and messages of a report on an in-repository engine and the exact motion."""
    page = scene.with_suffix(".html")
    done = beads("report", scene, "--out", page, "--runs", runs, "--engine", "verlet", "--allow-missing")
    return done.returncode, page.read_text() if page.exists() else "", done.stderr


@pytest.fixture
def scene(scene_file: SceneWriter) -> Path:
    times_us = np.arange(0.0, 320.0)
    readings = 20 * np.exp(-(((times_us - 150) / 12) ** 2)) + np.random.default_rng(1).normal(0.0, 0.2, len(times_us))
    path = scene_file(chain="sensors = [{ from_wall = 3 }]")
    pd.DataFrame({"time_us": times_us, "wall_N": readings}).to_csv(path.parent / "shot.csv", index=False)
    return path


def test_a_scene_shows_its_measured_traces_and_quoted_values(scene: Path, shared_runs: Path) -> None:
    text = scene.read_text()
    code, without, _ = report(scene, shared_runs)
    assert code == 0
    assert HEADING not in without
    pictures = without.count("data:image/svg")
    for entries, more in ((QUOTED, 0), (ENTRY + QUOTED, 1)):
        scene.write_text(text + entries)
        code, page, _ = report(scene, shared_runs)
        assert code == 0
        assert page.count(HEADING) == 1
        assert page.count("data:image/svg") == pictures + more
    assert re.search(r"Do the measurements fit\?.*is the furthest, [\d.e+]+ standard errors", page)
    section = page.split(HEADING)[1].split("</section>")[0]
    assert not [words for words in ("wall_amplitude_N", "wall_impulse_N_s", "shot.csv") if words not in section]
    scene.write_text(f'{text}{ENTRY}trigger = "1 s"\n')  # none of the trace can be laid over the run
    code, page, _ = report(scene, shared_runs)
    assert code == 0
    assert "0 readings from" in page.split(HEADING)[1]


def test_a_wrong_file_is_named_before_anything_runs(scene: Path, tmp_path: Path) -> None:
    scene.write_text(scene.read_text() + ENTRY)
    (scene.parent / "shot.csv").write_text("time_us,wall_N\n1,x\n")
    code, page, said = report(scene, tmp_path / "runs")
    assert (code, page) == (2, "")
    assert 'line 2, wall_N: found "x"' in said
    assert not (tmp_path / "runs").exists()
