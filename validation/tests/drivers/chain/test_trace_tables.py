"""Tables of traces: a column for each body, lists for long chains, the same numbers in both."""

import json
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from pandas.testing import assert_frame_equal

import postproc
from drivers.base.errors import InputError
from drivers.chain.trace import (
    FORCE_COLUMNS,
    MAX_COLUMNS,
    STATE_COLUMNS,
    Trace,
    fields_in,
    finite_part,
    table_of_trace,
)
from drivers.run.run_folder import open_run
from postproc.read import run_tables
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import case_of


def _trace(samples: int, bodies: int) -> Trace:
    rng = np.random.default_rng(samples * bodies)
    time, kinetic, total, momentum, friction = rng.random((5, samples))
    force, height, velocity, bore = rng.random((4, samples, bodies))
    across, spin = rng.random((2, samples, bodies, 2)), rng.random((samples, bodies, 3))
    trace = Trace(time, force, kinetic, total, momentum, height, velocity, friction)
    return replace(trace, across_m=across[0], across_velocity_m_s=across[1], spin_rad_s=spin, bore_N=bore)


@pytest.mark.parametrize("bodies", [1, 7, MAX_COLUMNS, MAX_COLUMNS + 1])
def test_tables_return_the_same_bits(bodies: int) -> None:
    trace, stored = _trace(3, bodies), BytesIO()
    state = table_of_trace(trace, STATE_COLUMNS, {})
    pq.write_table(table_of_trace(trace, FORCE_COLUMNS, {}), stored)
    table = pq.read_table(stored)
    assert (len(table), len(table.column_names) < MAX_COLUMNS) == (3, bodies == MAX_COLUMNS + 1 or bodies < 10)
    back = Trace(**fields_in(table, FORCE_COLUMNS, bodies) | fields_in(state, STATE_COLUMNS, bodies))
    assert [name for name, values in vars(trace).items() if not np.array_equal(getattr(back, name), values)] == []
    assert back.place_m.shape == (3, bodies, 3)
    with pytest.raises((KeyError, ValueError)):
        fields_in(state, STATE_COLUMNS, bodies + 1)


def test_units_and_scene_are_in_the_metadata(tmp_path: Path) -> None:
    case = case_of("fig4-tube", "run.duration=4 us", "run.record=['forces', 'state']")
    run = finished(case, "verlet", tmp_path)
    units = dict[str, str]()
    for name in ("forces.parquet", "state.parquet"):
        schema = pq.read_schema(run.folder / name)
        units |= {field.name: field.metadata[b"unit"].decode() for field in schema}
        assert json.loads(schema.metadata[b"scene_si"]) == run.record.scene
    asked = "time_s contact_1_N kinetic_energy_J momentum_N_s body_1_height_m body_1_velocity_m_s body_1_spin_x_rad_s"
    assert [units[name] for name in asked.split()] == ["s", "N", "J", "N s", "m", "m/s", "rad/s"]
    assert "" not in units.values()
    about = {"scene": "fig4-tube", "title": case.scene.title, "engine": "verlet"}
    assert pd.read_parquet(run.folder / "forces.parquet").attrs == about


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_a_long_table_has_a_row_a_sample_and_contact(
    ending: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_tables, "BLOCK", 50)
    run = finished(case_of("fig4", "run.duration=20 us"), "verlet", tmp_path)
    path = run_tables.write_table(run, tmp_path / f"long.{ending}", long=True)
    table = pd.read_csv(path) if ending == "csv" else pd.read_parquet(path)
    assert_frame_equal(table, postproc.forces(run, long=True), check_dtype=False, check_exact=True)
    by_command = tmp_path / "new" / path.name
    done = beads("table", run.folder, "--long", "--out", by_command)
    assert (done.returncode, done.stdout) == (0, f"{by_command}\n")
    assert by_command.read_bytes() == path.read_bytes()
    wide = table.pivot(index="time_s", columns="contact", values="force_N")
    assert np.array_equal(wide, run.trace.force_N)
    run_tables.write_table(run, path, long=False)
    table = pd.read_csv(path) if ending == "csv" else pd.read_parquet(path)
    assert_frame_equal(table.set_index("time_s"), postproc.forces(run), check_exact=True)
    with pytest.raises(InputError, match=r"\.csv or \.parquet"):
        run_tables.write_table(run, tmp_path / "table.xlsx", long=True)


def test_a_long_chain_is_kept_in_a_list_a_sample(tmp_path: Path) -> None:
    few = (f"chain.count={MAX_COLUMNS}", "chain.sensors=[]", "run.duration=2 us", "run.record=['forces', 'state']")
    run = finished(case_of("fig4", *few), "verlet", tmp_path)
    table = pd.read_parquet(run.folder / "forces.parquet")
    assert list(table.columns) == ["time_s", "contact_N", "kinetic_energy_J", "total_energy_J", "momentum_N_s"]
    stored, forces = open_run(run.folder), postproc.forces(run)
    assert np.array_equal(np.stack([*table["contact_N"]]), stored.trace.force_N)
    assert forces.columns[MAX_COLUMNS] == f"contact_{MAX_COLUMNS + 1}_N"
    assert np.array_equal(forces["contact_2_N"], stored.trace.force_N[:, 1])
    assert stored.state.place_m.shape == (3, MAX_COLUMNS + 1, 3)


def test_only_finite_samples_of_a_failed_run_are_kept() -> None:
    trace = _trace(5, 2)
    trace.force_N[3, 1] = np.nan
    kept = finite_part(trace)
    assert kept is not None
    assert len(kept.time_s) == 3
    trace.total_energy_J[0] = np.inf
    assert finite_part(trace) is None
