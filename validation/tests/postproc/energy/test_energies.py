"""Energies of bodies and contacts add up to those of the trace, and flow past beads as their equations say."""

from pathlib import Path

import numpy as np
import pytest
from pyarrow.parquet import read_table

from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import Trace
from postproc.energy.energies import energies_of, range_energy_J, range_numbers
from postproc.paper.simulate import exact
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import SceneWriter, case_of

WITH_STATE = 'run.record=["forces", "state"]'
LOAD = ("chain.precompression=10 N", "striker.speed=1 cm/s")
ELASTIC = [
    ("fig4",),
    ("fig4", "wall="),
    ("fig4", "wall=", "gravity="),
    ("fig4", *LOAD),
    ("steel-chain",),
    ("driven-steel",),
]
DAMPED = {  # measured errors of the dissipated energy, relative to the largest kinetic energy, times 1.5
    ("fig4", "contact.restitution=0.9"): 6.2e-4,
    ("fig4", "contact.restitution=0.9", "run.sample_interval=0.5 us"): 3e-4,
    ("fig4", "contact.dissipation=power", "contact.gamma=0.5"): 1e-6,
    ("fig4", "contact.dissipation=kuwabara-kono", "contact.relaxation=1 us"): 1.8e-4,
}


def balance(case: Case, trace: Trace) -> float:
    """Largest error of the sums over all bodies and contacts, relative to the largest kinetic energy."""
    energies = energies_of(case.chain, trace)
    largest = trace.kinetic_energy_J.max()
    whole = energies.body_J.sum(axis=1) - (0 if trace.drive_work_J is None else trace.drive_work_J)
    assert np.abs(energies.sums_J["kinetic"] - trace.kinetic_energy_J).max() < 1e-14 * largest
    assert np.abs(whole - trace.total_energy_J).max() < 1e-9 * largest  # heights hold 1e-17 m
    lost = trace.total_energy_J[0] - trace.total_energy_J
    return float(np.abs(energies.sums_J["dissipated"] - lost).max() / largest)


@pytest.mark.parametrize("settings", ELASTIC)
def test_elastic_energies_add_up_and_nothing_is_dissipated(settings: tuple[str, ...]) -> None:
    case = case_of(*settings)
    assert balance(case, exact(case).trace) < 2e-8  # 1e-8 is the error of the work of a drive, integrated from samples
    assert not energies_of(case.chain, exact(case).trace).dissipated_J.any()


@pytest.mark.parametrize("settings", DAMPED)
def test_the_dissipated_energy_is_the_loss_of_the_total_energy(settings: tuple[str, ...]) -> None:
    case = case_of(*settings)
    lost = energies_of(case.chain, exact(case).trace).sums_J["dissipated"]
    assert lost[-1] > 0.1 * exact(case).trace.total_energy_J[0]
    assert balance(case, exact(case).trace) < DAMPED[settings]


@pytest.mark.parametrize("settings", [*ELASTIC, ("fig4", "contact.dissipation=power", "contact.gamma=0.5")])
def test_energy_below_a_bead_has_passed_it(settings: tuple[str, ...]) -> None:
    """Below bead 9: bodies 1 to 8, contacts 1 to 9 and the energy dissipated in them."""
    case = case_of(*settings)
    energies = energies_of(case.chain, exact(case).trace)
    below = (energies.kinetic_J + energies.load_J)[:, :8].sum(axis=1)
    below += (energies.elastic_J + energies.dissipated_J)[:, :9].sum(axis=1)
    assert np.abs(energies.passed_J[:, 8] - (below - below[0])).max() < 1e-6 * exact(case).trace.kinetic_energy_J.max()


def test_a_wave_leaves_a_range_of_beads() -> None:
    """The wave carries nearly all energy; it passes bead 10 between the arrivals at beads 12 and 8."""
    case = case_of("fig4", "chain.sensors=[{from_wall=12}, {from_wall=8}]")
    energies = energies_of(case.chain, exact(case).trace)
    upper = range_numbers(energies, 10, 22)
    assert upper["passed_J"] == pytest.approx(exact(case).trace.kinetic_energy_J[0], rel=0.01)
    arrivals = [exact(case).values[f"bead_{bead}_arrival_s"] for bead in (12, 8)]
    assert arrivals[0] < upper["left_s"] < arrivals[1]
    halves = range_energy_J(energies, 1, 9) + range_energy_J(energies, 10, 22)
    assert halves == pytest.approx(energies.body_J.sum(axis=1), rel=1e-12)
    assert upper["share_at_end"] + range_numbers(energies, 1, 9)["share_at_end"] == pytest.approx(1)
    assert np.isnan(range_numbers(energies, 1, 22)["left_s"])


def test_a_run_of_a_code_that_steps_through_heights_has_its_energies() -> None:
    case = case_of("fig4", "run.duration=0.3 ms")
    assert balance(case, verlet_of(case)) < 1e-3  # the drift of velocity Verlet


def test_on_the_command_line(scene_file: SceneWriter, shared_runs: Path, tmp_path: Path) -> None:
    run = finished(case_of(scene_file(), WITH_STATE), "verlet", shared_runs)
    done = beads("energy", run.folder, "--beads", "1-2", "--results", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    name = f"energy-verlet-{run.folder.name}"
    assert {path.name for path in (tmp_path / "out").glob("[!.]*")} == {
        f"{name}.{kind}" for kind in ("csv", "png", "svg", "parquet")
    }
    table = read_table(tmp_path / "out" / f"{name}.parquet").to_pandas()
    kinetic = table.filter(like="_kinetic_J").sum(axis=1)
    assert np.allclose(kinetic, run.trace.kinetic_energy_J, rtol=1e-12)
    for wrong in ("0-1", "2-1", "1-99", "1-2-3", "-1", "nan", "1e400"):
        refused = beads("energy", run.folder, "--beads", wrong, "--results", tmp_path)
        assert (refused.returncode, len(refused.stderr.strip().splitlines())) == (2, 1)


def test_runs_without_positions_or_with_sideways_motion_are_refused(scene_file: SceneWriter, tmp_path: Path) -> None:
    cases = {"run.record=": case_of(scene_file()), "sideways": case_of("fig4-tube", "run.duration=20 us")}
    for words, case in cases.items():
        refused = beads("energy", finished(case, "verlet", tmp_path / "runs").folder)
        assert (refused.returncode, len(refused.stderr.strip().splitlines())) == (2, 1)
        assert words in refused.stderr
