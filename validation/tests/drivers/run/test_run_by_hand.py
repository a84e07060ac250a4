"""Tests of decks that were run by hand and imported, and of failed runs, which keep their forces."""

import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from drivers.engines import load_engine
from drivers.run.run_folder import open_run, record_of
from validation.tests.helpers.commands import assert_in_order, beads
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import SceneWriter

CHANGES = {  # of a deck by hand: the file, text and its replacement, the line of the record, and the law that it makes
    "liggghts": ("chain.data", r"\n3 1 (\S+) (\S+)", r"\n3 1 \1 2500", "chain.data: +3 1 0.00476 2500", "bead 3 "),
    "lammps": ("chain.in", r"timestep +1e-07", "timestep 2e-07", "chain.in: +timestep 2e-07", "a time step 2 "),
    "yade": (
        "chain.py",
        r"damping=0\b",
        "damping=0.01",
        "chain.py: + NewtonIntegrator(damping=0.01",
        "non-viscous damping of 0.",
    ),
}


def _by_hand(engine: str, scene: Path, folder: Path, edit: bool = True) -> None:
    """Render a deck, change it, and run it by the command of its first line."""
    assert beads("render", scene, "--engine", engine, "--out", folder).returncode == 0
    name, old, new, *_ = CHANGES[engine]
    if edit:
        text = (folder / name).read_text()
        (folder / name).write_text(re.sub(old, new, text))
        assert (folder / name).read_text() != text
    main = next(file for file in ("chain.in", "chain.py") if (folder / file).is_file())
    command = (folder / main).read_text().partition("\n")[0].removeprefix("# ")
    bare = {name: os.environ[name] for name in ("PATH", "HOME") if name in os.environ} | load_engine(engine).environment
    subprocess.run(command, shell=True, cwd=folder, env=bare, stdin=subprocess.DEVNULL, capture_output=True, check=True)


@pytest.mark.parametrize("engine", CHANGES)
def test_a_changed_deck_run_by_hand_comes_back(engine: str, scene_file: SceneWriter, tmp_path: Path) -> None:
    need(engine)
    scene, deck, runs = scene_file(), tmp_path / "deck", tmp_path / "runs"
    _by_hand(engine, scene, deck)
    done = beads("import", deck, "--engine", engine, "--runs", runs)
    assert (done.returncode, record_of(Path(done.stdout.strip())).status) == (0, "done")
    *_, line, law = CHANGES[engine]
    assert line in done.stderr
    assert "the engine did not run the scene as written" in done.stderr

    folder = Path(done.stdout.strip())
    own = beads("run", scene, "--engine", engine, "--runs", runs).stdout.strip()
    compared = beads("compare", own, folder)
    assert compared.returncode == 1
    assert re.search(
        rf"second .*\n.*run by hand.*\n +deck changed: .*\n +deck changed: {re.escape(line)}", compared.stdout
    )
    assert law in compared.stdout
    assert f"{engine}:scene" in beads("runs", "--runs", runs).stdout
    assert folder != Path(own)
    for command in ("observables", "spacetime", "film", "vtk"):
        results = () if command == "observables" else ("--results", tmp_path / "results")
        assert beads(command, folder, *results).returncode == 0
    assert "imported" in beads("runs", "--prune", "--runs", runs).stdout or folder.is_dir()


def test_an_unchanged_deck_run_by_hand_is_the_run(scene_file: SceneWriter, tmp_path: Path) -> None:
    need("lammps")
    scene, deck, runs = scene_file(), tmp_path / "deck", tmp_path / "runs"
    _by_hand("lammps", scene, deck, edit=False)
    done = beads("import", deck, "--engine", "lammps", "--runs", runs)
    assert "deck changed: nothing" in done.stderr
    own = open_run(Path(beads("run", scene, "--engine", "lammps", "--runs", runs).stdout.strip()))
    assert np.array_equal(open_run(Path(done.stdout.strip())).trace.force_N, own.trace.force_N)

    other = beads(
        "import", deck, "--engine", "lammps", "--runs", runs, "--scene", scene, "--set", "striker.speed=2 m/s"
    )
    assert other.returncode == 0
    assert "chain.data" in other.stderr  # the velocities are not those of this scene
    (deck / "chain.bin").write_bytes((deck / "chain.bin").read_bytes()[:5000])
    cut = beads("import", deck, "--engine", "lammps", "--runs", runs)
    assert cut.returncode == 1
    assert_in_order(cut.stderr.strip(), "deck: output ends in sample", "of 301")


def test_what_cannot_be_imported(scene_file: SceneWriter, tmp_path: Path) -> None:
    scene, deck = scene_file(), tmp_path / "deck"
    deck.mkdir()
    for words, said in (
        ((deck, "--engine", "verlet"), "scene.json: no such file; give the scene of the deck by --scene"),
        (
            (deck, "--engine", "verlet", "--scene", scene),
            "chain.json: found No such file or directory; allowed: a file",
        ),
        ((deck, "--engine", "verlet", "--set", "chain.count=3"), "--set: needs --scene"),
        ((deck,), "--engine: found none; allowed: one engine"),
    ):
        done = beads("import", *words, "--runs", tmp_path / "runs")
        assert done.returncode == 2
        assert said in done.stderr
        assert done.stderr.count("\n") == 1
    assert not (tmp_path / "runs" / "verlet").exists()
    assert beads("render", scene, "--engine", "verlet", "--out", deck).returncode == 0
    none = beads("import", deck, "--engine", "verlet", "--runs", tmp_path / "runs")
    assert (none.returncode, none.stdout) == (1, "")
    assert "chain.npy was not written" in none.stderr


@pytest.mark.parametrize("engine", ["verlet", "yade"])
def test_a_failed_run_keeps_its_forces(engine: str, tmp_path: Path) -> None:
    need(engine)
    runs, step = tmp_path / "runs", ("--set", "run.time_step=20 us", "--set", "run.sample_interval=20 us")
    words = ("run", "fig4", "--engine", engine, "--runs", runs, "--unsafe", *step)
    done = beads(*words)
    assert done.returncode == 1
    run = open_run(Path(done.stdout.strip()), failed=True)
    assert run.record.status == "failed"
    assert run.has_state
    assert np.isfinite(run.trace.force_N).all()
    assert 0 < len(run.trace.time_s) <= run.record.scene["samples"]

    shown = beads("observables", run.folder)
    assert shown.returncode == 0
    assert_in_order(shown.stderr.strip(), "failed, shown until", "unstable at t = ")
    assert beads("film", run.folder, "--results", tmp_path / "results").returncode == 0
    by_name = beads("observables", f"{engine}:fig4", "--runs", runs)
    assert by_name.returncode == 2
    assert "no such run" in by_name.stderr
    compared = beads("compare", run.folder, _copy(run.folder))
    assert compared.returncode == 1
    assert compared.stdout.startswith("FAIL: the first run failed; the second run failed")


def _copy(folder: Path) -> Path:
    copy = folder.with_name("copy")
    copy.mkdir()
    for file in folder.iterdir():
        (copy / file.name).write_bytes(file.read_bytes())
    return copy
