"""Energies of bodies and contacts add up to those of the trace, and flow past beads as their equations say."""

from pathlib import Path

import numpy as np
import pytest
from pyarrow.parquet import read_table

from drivers.chain.schemes import verlet_motion, verlet_of
from drivers.engines import REFERENCE
from postproc.draw.energies import energies_of, range_energy_J, range_numbers
from postproc.read.motion import exact
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import SceneWriter, case_of

SCENES = [
    ("fig4",),
    ("fig4", "chain.precompression=10 N", "striker.speed=1 cm/s"),
    ("driven-steel",),
    ("fig4", "contact.restitution=0.9"),
    ("fig4", "contact.dissipation=power", "contact.gamma=0.5"),
    ("fig4", "contact.dissipation=kuwabara-kono", "contact.relaxation=1 us"),
]


@pytest.mark.parametrize("settings", SCENES)
def test_energies_add_up_what_is_dissipated_is_lost_and_what_is_below_a_bead_has_passed_it(
    settings: tuple[str, ...],
) -> None:
    """Below bead 9: bodies 1 to 8, contacts 1 to 9 and the energy dissipated in them."""
    case = case_of(*settings)
    trace = exact(case).trace
    energies, largest_J = energies_of(case, REFERENCE, trace), trace.kinetic_energy_J.max()
    whole = energies.body_J.sum(axis=1) - (0 if trace.drive_work_J is None else trace.drive_work_J)
    assert np.abs(energies.sums_J["kinetic"] - trace.kinetic_energy_J).max() < 1e-14 * largest_J
    assert np.abs(whole - trace.total_energy_J).max() < 1e-9 * largest_J  # heights hold 1e-17 m
    lost_J, dissipated_J = trace.total_energy_J[0] - trace.total_energy_J, energies.sums_J["dissipated"]
    assert np.abs(dissipated_J - lost_J).max() < 1e-9 * largest_J
    damped = any("contact." in setting for setting in settings)
    assert dissipated_J[-1] > 0.1 * trace.total_energy_J[0] if damped else not energies.contact_dissipated_J.any()
    below = (energies.body_kinetic_J + energies.body_load_J)[:, :8].sum(axis=1)
    below += (energies.contact_elastic_J + energies.contact_dissipated_J)[:, :9].sum(axis=1)
    assert np.abs(energies.body_passed_J[:, 8] - (below - below[0])).max() < 1e-9 * largest_J


def test_what_a_code_dissipates_is_that_of_its_scheme() -> None:
    case = case_of(*SCENES[3])
    energies = energies_of(case, "lammps", verlet_of(case))
    np.testing.assert_array_equal(energies.contact_dissipated_J, verlet_motion(case, energies=True).dissipated_J)
    exact_J = energies_of(case, REFERENCE, exact(case).trace).contact_dissipated_J
    assert 1e-6 < np.abs(energies.contact_dissipated_J - exact_J).max() / exact_J.max() < 1e-2


def test_a_wave_leaves_a_range_of_beads() -> None:
    """The wave carries nearly all energy; it passes bead 10 between the arrivals at beads 12 and 8."""
    case = case_of("fig4", "chain.sensors=[{from_wall=12}, {from_wall=8}]")
    energies = energies_of(case, REFERENCE, exact(case).trace)
    upper, lower = (range_numbers(energies, *ends) for ends in ((10, 22), (1, 9)))
    assert upper["passed_J"] == pytest.approx(exact(case).trace.kinetic_energy_J[0], rel=0.01)
    arrivals = [exact(case).values[f"bead_{bead}_arrival_s"] for bead in (12, 8)]
    assert arrivals[0] < upper["left_s"] < arrivals[1]
    halves = range_energy_J(energies, 1, 9) + range_energy_J(energies, 10, 22)
    assert halves == pytest.approx(energies.body_J.sum(axis=1), rel=1e-12)
    assert upper["share_at_end"] + lower["share_at_end"] == pytest.approx(1)
    assert np.isnan(range_numbers(energies, 1, 22)["left_s"])


def test_the_command_writes_the_energies_of_a_straight_chain_with_positions(
    scene_file: SceneWriter, shared_runs: Path, tmp_path: Path
) -> None:
    run = finished(case_of(scene_file(), 'run.record=["forces", "state"]'), "verlet", shared_runs)
    done = beads("energy", run.folder, "--beads", "1-2", "--results", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    files = {path.suffix: path for path in (tmp_path / "out").glob(f"energy-verlet-{run.folder.name}.*")}
    assert set(files) == {".csv", ".png", ".svg", ".parquet"}
    table = read_table(files[".parquet"]).to_pandas()
    kinetic, elastic, load = (table.filter(like=f"_{name}_J").sum(axis=1) for name in ("kinetic", "elastic", "load"))
    assert np.allclose(kinetic, run.trace.kinetic_energy_J, rtol=1e-12)
    assert np.allclose(kinetic + elastic + load, run.trace.total_energy_J, rtol=1e-8)
    bare, tube = case_of(scene_file("bare", duration="0.2 ms")), case_of("fig4-tube", "run.duration=20 us")
    for words, message in [
        ((run.folder, "--beads", "2-1"), "2-1"),
        ((run.folder, "--beads", "1-99"), "1-99"),
        ((run.folder, "--beads", "nan"), "nan"),
        ((finished(bare, "verlet", shared_runs).folder,), "run.record="),
        ((finished(tube, "verlet", shared_runs).folder,), "sideways"),
    ]:
        refused = beads("energy", *words)
        assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
        assert message in refused.stderr
