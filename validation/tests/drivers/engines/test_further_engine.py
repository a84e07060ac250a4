"""What a further engine finds ready: a look of its own, readers of raw output, tables of pairs."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.base.errors import RunError
from drivers.engines import Engine, load_engine
from drivers.engines._deck_values import table_of_pairs
from drivers.engines._raw_output import FRAME_HEAD, contact_forces, read_dump, read_partial_dump
from postproc.draw import style
from validation.tests.helpers.scenes import case_of

LONGER_HEAD: tuple[tuple[Any, ...], ...] = (("magic", "S10"), *FRAME_HEAD, ("names", "S5"))


def test_engines_without_a_style_look_different(monkeypatch: pytest.MonkeyPatch) -> None:
    shipped = ["liggghts", "reference", "verlet", "yade"]
    plain = {f"mine{place}": replace(load_engine("verlet"), style=None) for place in range(len(style.SPARE))}

    def load(name: str) -> Engine:
        return plain[name] if name in plain else load_engine(name)

    monkeypatch.setattr(style, "engine_names", lambda: sorted([*shipped, *plain]))
    monkeypatch.setattr(style, "load_engine", load)
    looks = [style.line_of.__wrapped__(name) for name in (*shipped, *plain)]
    assert len({look.colour for look in looks}) == len(looks)
    assert all(look == load_engine(name).style for name, look in zip(shipped, looks, strict=False))


@pytest.mark.parametrize("head", [FRAME_HEAD, LONGER_HEAD])
def test_a_dump_is_read_whatever_stands_in_its_head(head: tuple[tuple[Any, ...], ...], tmp_path: Path) -> None:
    case, columns, path = case_of("fig4", "run.duration=3 us"), ("id", "z"), tmp_path / "dump.bin"
    bodies, samples = case.chain.bodies, case.scene.samples
    frames = np.zeros(samples, [*head, ("values", "f8", (bodies, 2))])
    frames["step"], frames["atoms"], frames["count"] = case.sample_steps, bodies, 2 * bodies
    frames["values"] = np.stack([np.broadcast_to(np.arange(1, bodies + 1), (samples, bodies))] * 2, axis=2)
    path.write_bytes(frames.tobytes())
    np.testing.assert_array_equal(read_dump(case, path, columns, head)["z"], frames["values"][:, :, 1])
    frames["atoms"][-1] -= 1
    path.write_bytes(frames.tobytes())
    with pytest.raises(RunError, match="torn in sample 4"):
        read_dump(case, path, columns, head)
    left = read_partial_dump(case, path, columns, head)
    assert left is not None
    assert left["z"].shape == (samples - 1, bodies)


def test_tables_of_pairs_are_symmetric() -> None:
    assert table_of_pairs(["a", "b"], [("b", "a", 3.0)], 1.0) == [1.0, 3.0, 3.0, 1.0]


def test_contact_forces_are_summed_from_the_lowest_up() -> None:
    np.testing.assert_array_equal(contact_forces(np.array([5.0]), np.array([[1.0, 2.0, 9.0]])), [[5.0, 4.0, 2.0]])
