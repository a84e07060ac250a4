"""Tests of decks that were run by hand and imported, and of failed runs, which keep their forces."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np

from drivers.engines import load_engine
from drivers.run.run_folder import open_run, record_of
from validation.tests.helpers.commands import assert_in_order, beads
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import SceneWriter

CODE = "lammps"


def run_by_hand(folder: Path) -> None:
    """Run a deck of LAMMPS by the command of its first line."""
    command = (folder / "chain.in").read_text().partition("\n")[0].removeprefix("# ")
    bare = {name: os.environ[name] for name in ("PATH", "HOME") if name in os.environ} | load_engine(CODE).environment
    subprocess.run(command, shell=True, cwd=folder, env=bare, stdin=subprocess.DEVNULL, capture_output=True, check=True)


def test_deck_run_by_hand_comes_back(scene_file: SceneWriter, tmp_path: Path) -> None:
    """Unchanged it is the run; a change is reported with its lines and the law that it makes."""
    need(CODE)
    scene, deck, runs = scene_file(), tmp_path / "deck", tmp_path / "runs"
    words = ("import", deck, "--engine", CODE, "--runs", runs)
    assert beads("render", scene, "--engine", CODE, "--out", deck).returncode == 0
    run_by_hand(deck)
    done = beads(*words)
    assert "deck changed: nothing" in done.stderr
    run = open_run(Path(beads("run", scene, "--engine", CODE, "--runs", runs).stdout.strip()))
    assert np.array_equal(open_run(Path(done.stdout.strip())).trace.force_N, run.trace.force_N)
    other = beads(*words, "--scene", scene, "--set", "striker.speed=2 m/s")
    assert other.returncode == 0
    assert "chain.data" in other.stderr  # the velocities are not those of this scene

    text, changes = re.subn(r"\n3 1 (\S+) (\S+)", r"\n3 1 \1 2500", (deck / "chain.data").read_text())
    assert changes == 1
    (deck / "chain.data").write_text(text)
    run_by_hand(deck)
    done = beads(*words)
    folder = Path(done.stdout.strip())
    assert (done.returncode, record_of(folder).status) == (0, "done")
    assert "chain.data: +3 1 0.00476 2500" in done.stderr
    assert "warning: departs from its scheme from " in done.stderr
    compared = beads("compare", run.folder, folder)
    assert compared.returncode == 1
    edit = r"second +deck changed: "
    changed = rf"second .*\n.*run by hand.*\n{edit}.*\n{edit}chain.data: \+3 1 0.00476 2500"
    assert re.search(changed, compared.stdout)
    assert "bead 3 " in compared.stdout

    (deck / "chain.bin").write_bytes((deck / "chain.bin").read_bytes()[:5000])
    cut = beads(*words)
    assert cut.returncode == 1
    assert_in_order(cut.stderr.strip(), "deck: output ends in sample", "of 301")


def test_incomplete_folders_are_not_imported(scene_file: SceneWriter, tmp_path: Path) -> None:
    scene, deck, runs = scene_file(), tmp_path / "deck", ("--runs", tmp_path / "runs")
    verlet = (deck, "--engine", "verlet")
    deck.mkdir()
    for words, said in (
        (verlet, "scene.json: no such file; give the scene of the deck by --scene"),
        ((*verlet, "--scene", scene), "chain.json: found no such file; allowed: a file"),
        ((*verlet, "--set", "chain.count=3"), "--set: needs --scene"),
        ((deck,), "missing option '--engine'"),
        ((*verlet, "--engine", "yade"), "'--engine': found verlet, yade; allowed: one"),
    ):
        done = beads("import", *words, *runs)
        assert done.returncode == 2
        assert said in done.stderr
        assert done.stderr.count("\n") == 1
    assert not (tmp_path / "runs" / "verlet").exists()
    assert beads("render", scene, "--engine", "verlet", "--out", deck).returncode == 0
    none = beads("import", *verlet, *runs)
    assert (none.returncode, none.stdout) == (1, "")
    assert "chain.npy was not written" in none.stderr


def test_failed_run_keeps_its_forces(tmp_path: Path) -> None:
    step = ("--set", "run.time_step=20 us", "--set", "run.sample_interval=20 us")
    done = beads("run", "fig4", "--engine", "verlet", "--runs", tmp_path / "runs", "--unsafe", *step)
    assert done.returncode == 1
    run = open_run(Path(done.stdout.strip()), failed=True)
    assert run.record.status == "failed"
    assert run.has_state
    assert np.isfinite(run.trace.force_N).all()
    assert 0 < len(run.trace.time_s) <= run.record.scene["samples"]
    shown = beads("observables", run.folder)
    assert shown.returncode == 0
    assert_in_order(shown.stderr.strip(), "failed, shown until", "unstable at t = ")
    compared = beads("compare", run.folder, shutil.copytree(run.folder, tmp_path / "copy"))
    assert compared.returncode == 1
    assert compared.stdout.startswith("FAIL: the first run failed; the second run failed")
