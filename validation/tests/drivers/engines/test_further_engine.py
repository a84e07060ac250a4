"""Tests of functions for further engines: styles, readers of raw output, tables of pairs."""

from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.base.errors import RunError
from drivers.base.processes import run_command
from drivers.chain.case import Case
from drivers.engines import Engine, codes, engine_names, installed_codes, load_engine
from drivers.engines._lammps_family import DUMP, table_of_pairs
from drivers.engines._raw_output import contact_forces, read_dump, read_partial_dump
from drivers.run.guard import checked_trace
from postproc.draw import style
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import case_of


def test_builds_and_engines_without_a_style_look_different(monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = [name for name in engine_names() if load_engine(name).style]
    some = load_engine(next(name for name in codes() if name in shipped))
    plain = {f"a-build{place}": replace(some, name=f"a-build{place}") for place in range(2)}
    plain |= {
        f"mine{place}": replace(some, name=f"mine{place}", style=None) for place in range(len(style.EXTRA_STYLES) - 2)
    }

    def load(name: str) -> Engine:
        return plain[name] if name in plain else load_engine(name)

    monkeypatch.setattr(style, "engine_names", lambda: sorted([*shipped, *plain]))
    monkeypatch.setattr(style, "load_engine", load)
    looks = [style.line_of.__wrapped__(name) for name in (*shipped, *plain)]
    assert len({look.colour for look in looks}) == len(looks)
    assert all(look == load_engine(name).style for name, look in zip(shipped, looks, strict=False))


HEAD: tuple[tuple[Any, ...], ...] = (
    ("step", "i8"), ("atoms", "i8"), ("triclinic", "i4"), ("boundary", "i4", 6), ("box", "f8", 6), ("columns", "i4"),
)  # fmt: skip
MAGIC = (-10).to_bytes(8, "little", signed=True) + b"DUMPCUSTOM" + (1).to_bytes(4, "little") + (2).to_bytes(4, "little")


def dump_of(case: Case, shares: tuple[int, ...], *, since_2020: bool) -> np.ndarray[Any, np.dtype[np.void]]:
    """Frames of a binary dump with ``id`` and ``z`` (equal to the atom's number), in a chunk for each process."""
    before = [("magic", "V26")] if since_2020 else []
    behind = [("units", "i4"), ("timed", "i1"), ("letters", "i4"), ("names", "S4")] if since_2020 else []
    chunks = [((f"count{i}", "i4"), (f"values{i}", "f8", (share, 2))) for i, share in enumerate(shares)]
    fields: list[Any] = [*before, *HEAD, *behind, ("processes", "i4"), *chain.from_iterable(chunks)]
    frames = np.zeros(case.scene.samples, fields)
    if since_2020:
        frames["magic"] = np.void(MAGIC)
    frames["step"], frames["atoms"], frames["processes"] = case.sample_steps, sum(shares), len(shares)
    ids = np.repeat(np.arange(1, sum(shares) + 1)[:, np.newaxis], 2, axis=1)
    for i, part in enumerate(np.split(ids, np.cumsum(shares)[:-1])):
        frames[f"count{i}"], frames[f"values{i}"] = part.size, part
    return frames


@pytest.mark.parametrize("since_2020", [False, True])
@pytest.mark.parametrize("shares", [(22,), (11, 11), (7, 0, 15), (1,) * 22])
def test_a_dump_of_any_number_of_processes_is_read(shares: tuple[int, ...], since_2020: bool, tmp_path: Path) -> None:
    case, columns, path = case_of("fig4", "run.duration=3 us"), ("id", "z"), tmp_path / "dump.bin"
    frames = dump_of(case, shares, since_2020=since_2020)
    path.write_bytes(frames.tobytes())
    found = read_dump(case, path, columns)["z"]
    np.testing.assert_array_equal(found, np.broadcast_to(np.arange(1.0, 23), (4, 22)))
    fewer = dump_of(case, (shares[0] - 1, *shares[1:]), since_2020=since_2020)
    path.write_bytes(frames[:2].tobytes() + fewer[2:].tobytes())
    with pytest.raises(RunError, match="unstable at t = 2e-06 s: 21 bodies instead of 22, one was lost"):
        read_dump(case, path, columns)
    left = read_partial_dump(case, path, columns)
    assert left is not None
    assert left["z"].shape == (2, 22)
    for place, field, wrong in ((3, "atoms", 21), (2, "count0", 1), (0, "processes", 0)):
        frames[field][place] = wrong
        path.write_bytes(frames.tobytes())
        with pytest.raises(RunError, match=f"damaged in sample {place + 1}"):
            read_dump(case, path, columns)
    assert read_partial_dump(case, path, columns) is None


@pytest.mark.parametrize("since_2020", [False, True])
def test_processes_that_exchange_beads_are_reported(since_2020: bool, tmp_path: Path) -> None:
    case, path = case_of("fig4", "run.duration=3 us"), tmp_path / "dump.bin"
    one, other = (dump_of(case, shares, since_2020=since_2020) for shares in ((11, 11), (10, 12)))
    path.write_bytes(one[:2].tobytes() + other[2:].tobytes())
    with pytest.raises(RunError, match="output of 2 processes is in another order from sample 3 on"):
        read_dump(case, path, ("id", "z"))
    left = read_partial_dump(case, path, ("id", "z"))
    assert left is not None
    assert len(left["z"]) == 2


SEVERAL = [name for name in installed_codes() if DUMP in load_engine(name).render(case_of("fig4")).raw]


@pytest.mark.parametrize("processes", [2, 3])
@pytest.mark.parametrize("engine", SEVERAL)
def test_several_processes_give_the_same_bits(engine: str, processes: int, tmp_path: Path, shared_runs: Path) -> None:
    code, case = load_engine(engine), case_of("fig5", "contact.restitution=0.9", "run.duration=0.2 ms")
    build = code.find()
    assert build is not None
    deck, one_by_one = (
        code.render(case),
        f"processors 1 1 {processes}\nboundary ",
    )  # parts of the chain, one above another
    files = {name: text.replace("boundary ", one_by_one) for name, text in deck.files.items()}
    as_root = ("OMPI_ALLOW_RUN_AS_ROOT=1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1", "OMPI_MCA_rmaps_base_oversubscribe=1")
    deck = replace(deck, files=files, command=("env", *as_root, "mpirun", "-np", str(processes), *deck.command))
    deck.write(tmp_path)
    outcome = run_command(code.started(deck, build), tmp_path, 60, **code.environment)
    alone = finished(case, engine, shared_runs).trace
    np.testing.assert_array_equal(checked_trace(case, code, outcome, tmp_path).force_N, alone.force_N)


def test_tables_of_pairs_are_symmetric() -> None:
    assert table_of_pairs(["a", "b"], [("b", "a", 3.0)], 1.0) == [1.0, 3.0, 3.0, 1.0]


def test_contact_forces_are_summed_from_the_lowest_up() -> None:
    np.testing.assert_array_equal(contact_forces(np.array([5.0]), np.array([[1.0, 2.0, 9.0]])), [[5.0, 4.0, 2.0]])
