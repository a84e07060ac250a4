"""Codes on Fig. 4, and functions for further engines: readers of raw output, tables of pairs."""

from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.base.errors import RunError
from drivers.base.processes import run_command
from drivers.chain.case import Case
from drivers.engines import codes, installed_codes, load_engine
from drivers.engines._lammps_family import DUMP, table_of_pairs
from drivers.engines._raw_output import read_dump
from drivers.run.scheme import checked_trace
from postproc.read.observables import observe
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import case_of

HEAD: tuple[tuple[Any, ...], ...] = (
    ("step", "i8"), ("atoms", "i8"), ("triclinic", "i4"), ("boundary", "i4", 6), ("box", "f8", 6), ("columns", "i4"),
)  # fmt: skip
MAGIC = (-10).to_bytes(8, "little", signed=True) + b"DUMPCUSTOM" + (1).to_bytes(4, "little") + (2).to_bytes(4, "little")
COLUMNS = ("id", "z")


@pytest.mark.parametrize("engine", [*codes(), "reference"])
def test_fig4_reads_what_physics_says(engine: str, shared_runs: Path) -> None:
    run = finished(case_of("fig4"), engine, shared_runs)
    values = observe(run.layout, run.trace)
    assert values["bead_9_peak_N"] == pytest.approx(5.34, abs=0.005)
    assert values["bead_5_peak_N"] == pytest.approx(5.35, abs=0.005)
    assert values["wall_peak_N"] == pytest.approx(16.37, abs=0.005)
    assert values["energy_drift_J"] < 1e-5 * values["kinetic_energy_start_J"]
    assert values["impulse_imbalance_share"] < 1e-5


def dump_of(case: Case, shares: tuple[int, ...], *, since_2020: bool) -> np.ndarray[Any, np.dtype[np.void]]:
    """Frames of a binary dump with ``id`` and ``z`` (equal to the atom's number), in a chunk for each process."""
    before = [("magic", "V26")] if since_2020 else []
    behind = [("units", "i4"), ("timed", "i1"), ("letters", "i4"), ("names", "S4")] if since_2020 else []
    chunks = [((f"count{i}", "i4"), (f"values{i}", "f8", (share, 2))) for i, share in enumerate(shares)]
    fields: list[Any] = [*before, *HEAD, *behind, ("processes", "i4"), *chain.from_iterable(chunks)]
    frames = np.zeros(case.scene.samples, fields)
    if since_2020:
        frames["magic"], frames["letters"], frames["names"] = np.void(MAGIC), 4, b"id z"
    frames["step"], frames["atoms"], frames["processes"] = (
        range(0, case.scene.steps + 1, case.scene.steps_per_sample),
        sum(shares),
        len(shares),
    )
    ids = np.repeat(np.arange(1, sum(shares) + 1)[:, np.newaxis], 2, axis=1)
    for i, part in enumerate(np.split(ids, np.cumsum(shares)[:-1])):
        frames[f"count{i}"], frames[f"values{i}"] = part.size, part
    return frames


@pytest.mark.parametrize(
    ("shares", "since_2020"), [((22,), False), ((22,), True), ((7, 0, 15), False), ((11, 11), True)]
)
def test_a_dump_of_any_number_of_processes_is_read(shares: tuple[int, ...], since_2020: bool, tmp_path: Path) -> None:
    case, path = case_of("fig4", "run.duration=3 us"), tmp_path / "dump.bin"
    frames = dump_of(case, shares, since_2020=since_2020)
    path.write_bytes(frames.tobytes())
    np.testing.assert_array_equal(read_dump(case, path, COLUMNS)[0]["z"], np.broadcast_to(np.arange(1.0, 23), (4, 22)))
    fewer, other = (shares[0] - 1, *shares[1:]), (*shares[1:], shares[0])
    path.write_bytes(frames[:2].tobytes() + dump_of(case, other, since_2020=since_2020)[2:].tobytes())
    np.testing.assert_array_equal(read_dump(case, path, COLUMNS)[0]["z"], np.broadcast_to(np.arange(1.0, 23), (4, 22)))
    path.write_bytes(frames[:2].tobytes() + dump_of(case, fewer, since_2020=since_2020)[2:].tobytes())
    with pytest.raises(RunError, match="unstable at t = 2e-06 s: 21 bodies instead of 22, one was lost") as error:
        read_dump(case, path, COLUMNS)
    assert error.value.partial["z"].shape == (2, 22)
    for place, field, wrong in ((3, "atoms", 23), (2, "count0", 1), (0, "processes", 0)):
        frames[field][place] = wrong
        path.write_bytes(frames.tobytes())
        with pytest.raises(RunError, match=f"ends in sample {place + 1} of 4, or is damaged") as error:
            read_dump(case, path, COLUMNS)
        assert (error.value.partial is None) == (place == 0)


SEVERAL = [name for name in installed_codes() if DUMP in load_engine(name).render(case_of("fig4")).raw]


@pytest.mark.parametrize("engine", SEVERAL)
def test_several_processes_give_the_same_bits(engine: str, tmp_path: Path, shared_runs: Path) -> None:
    code, case = load_engine(engine), case_of("fig5", "contact.restitution=0.9", "run.duration=0.2 ms")
    deck, parts = code.render(case), "processors 1 1 3\nboundary "  # parts of the chain, one above another
    files = {name: text.replace("boundary ", parts) for name, text in deck.files.items()}
    as_root = ("OMPI_ALLOW_RUN_AS_ROOT=1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1", "OMPI_MCA_rmaps_base_oversubscribe=1")
    program = code.find() or ()
    mpirun = str(Path(program[0]).with_name("mpirun"))
    deck = replace(deck, files=files, command=("env", *as_root, mpirun, "-np", "3", *deck.command))
    deck.write(tmp_path)
    outcome = run_command(code.started(deck, program), tmp_path, 60, **code.environment)
    alone = finished(case, engine, shared_runs).trace
    np.testing.assert_array_equal(checked_trace(case, code, outcome, tmp_path).force_N, alone.force_N)


def test_tables_of_pairs_are_symmetric() -> None:
    np.testing.assert_array_equal(table_of_pairs("ab", [None, "b"], "aa", [7.0, 3.0], 1.0), [[1.0, 3.0], [3.0, 1.0]])
