"""Tests of decks that were run by hand and imported, and of failed runs, which keep their forces."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

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
        ((*verlet, "--set", "chain.count=3"), "scene.json: no such file; give the scene of the deck by --scene"),
        (("--engine", "verlet"), "no folder; give that of the deck, or --dump FILE"),
        ((*verlet, "--columns", "id,z"), "--columns: needs --dump"),
        ((*verlet, "--dump", "no.txt"), "no.txt, which is no file; allowed: the dump of a run"),
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


EVERY = ("custom 10 ", "custom 20 ")
HALF = (r"timestep .*", "timestep 0.05e-6"), ("run .*", "run 6000")
BOTH = "has frames at steps 0, 20, ..., {} the scene has 0, 10, ..., 3000{}: --set "
EDITS: dict[str, tuple[str, tuple[tuple[str, str], ...], str, tuple[str, ...]]] = {
    "a dump every 20 steps": (
        "chain.in", (EVERY,), BOTH.format("3000 of 0.1 us;", " of 0.1 us") + "run.sample_interval='2 us'",
        ("--set", "run.sample_interval=2 us"),
    ),
    "half the step": (
        "chain.in", (EVERY, *HALF), BOTH.format("6000 of 50 ns;", " of 0.1 us") + "run.time_step='50 ns'",
        ("--set", "run.time_step=50 ns"),
    ),
    "a longer run": (
        "chain.in", (("run  .*", "run 4000"),),
        BOTH.replace("20", "10").format("4000 of 0.1 us;", " of 0.1 us") + "run.duration='0.4 ms'",
        ("--set", "run.duration=0.4 ms"),
    ),
    "other columns": (
        "chain.in", (("chain.bin id z", "chain.bin id type x y vx vy fx fy z"),),
        "chain.bin has 12 columns, expected 5 (id z vz f_contacts[3] f_force_wall[3]); name them: --columns",
        ("--dump", "chain.bin", "--columns", "id,type,x,y,vx,vy,fx,fy,z,vz,f_contacts[3],f_force_wall[3]"),
    ),
    "a second striker": (
        "chain.data",
        (("6 atoms", "7 atoms"), (r"\S+ \S+ zlo", "-0.01 0.2 zlo"),
         (r"\n\nVelocities", "\n7 1 0.00476 2171 0 0 0.04\n\nVelocities"), (r"\Z", "7 0 0 -1 0 0 0\n")),
        "chain.bin has 7 atoms, expected 6", (),
    ),
    "a text": (
        "chain.in", (("chain.bin", "dump.txt"),), "chain.bin not found; found dump.txt: --dump dump.txt",
        ("--dump", "dump.txt"),
    ),
    "spaces": ("chain.in", (("  +", " "), ("\nrun", "\n\n  run")), "", ()),
}  # fmt: skip


QUICK = ("a dump every 20 steps", "a text", "spaces")


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.long] * (name not in QUICK)) for name in EDITS])
def test_an_edit_is_named_in_words_that_help(name: str, scene_file: SceneWriter, tmp_path: Path) -> None:
    """The advice works; an edit of spaces alone is none."""
    need("liggghts")
    file, changes, said, further = EDITS[name]
    deck = tmp_path / "deck"
    words = ("import", deck, "--engine", "liggghts", "--runs", tmp_path / "runs")
    assert beads("render", scene_file(), "--engine", "liggghts", "--out", deck).returncode == 0
    text = (deck / file).read_text()
    for pattern, other in changes:
        text, count = re.subn(pattern, other, text)
        assert count, pattern
    (deck / file).write_text(text)
    run_by_hand(deck)
    done = beads(*words)
    assert done.returncode == bool(said)
    assert said in done.stderr
    if further:
        done = beads(*words, *further)
        assert done.returncode == 0, done.stderr
    if done.returncode == 0:
        assert "the forces are those of its scheme to " in done.stderr
    assert ("deck changed: nothing" in done.stderr) == (name in ("spaces", "a dump every 20 steps"))


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
