"""Readers of raw output, for any adapter: arrays, binary dumps, and contact forces from the forces on bodies."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.base.errors import RunError
from drivers.chain.case import Case
from drivers.chain.chain import Array

# a frame of LIGGGHTS' binary dump up to its values, on one process; those of LAMMPS have some fields more
FRAME_HEAD: tuple[tuple[Any, ...], ...] = (
    ("step", "i8"),
    ("atoms", "i8"),
    ("triclinic", "i4"),
    ("boundary", "i4", 6),
    ("box", "f8", 6),
    ("columns", "i4"),
    ("processes", "i4"),
    ("count", "i4"),
)


def read_arrays(path: Path, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Array]:
    """Arrays of a ``.npz``, or the only one of a ``.npy``, by name and of the expected shapes.

    Raises:
        RunError: the file, an array or part of it is missing.
    """
    if not path.exists():
        raise RunError(f"no output: {path.name} was not written")
    try:
        stored = np.load(path, allow_pickle=False)
        alone = isinstance(stored, np.ndarray)
        found = dict(zip(shapes, [stored], strict=True)) if alone else {name: stored[name] for name in shapes}
        arrays = {name: array.astype(float, casting="safe", copy=False) for name, array in found.items()}
    except Exception as error:  # a torn file can make numpy and zipfile raise almost anything
        raise RunError(f"output is torn: {path.name}: {error}") from error
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise RunError(f"output has {name} of shape {arrays[name].shape}, expected {shape}")
    return arrays


def read_dump(
    case: Case, path: Path, columns: tuple[str, ...], head: tuple[tuple[Any, ...], ...] = FRAME_HEAD
) -> dict[str, Array]:
    """Columns of a binary dump by name, each of shape (samples, bodies).

    Args:
        case: the case; its bodies are atoms 1, 2, ... from the lowest up.
        path: the dump, whose frames are sorted by atom.
        columns: their names; the first is the atom's number.
        head: fields of a frame before its values, among them ``step``, ``atoms`` and ``count``.

    Raises:
        RunError: frames or bodies are missing, or the file is torn.
    """
    bodies, samples = case.chain.bodies, case.scene.samples
    frames = _frames(case, path, columns, head)
    good = _whole(case, frames, columns)
    if not good.all():
        first = int(np.argmin(good))
        atoms, count = frames["atoms"][first], frames["count"][first]
        if 0 <= atoms < bodies and count == atoms * len(columns):
            at = case.sample_times_s[min(first, samples - 1)]
            raise RunError(f"unstable at t = {at:g} s: {atoms} bodies instead of {bodies}, one was lost")
        raise RunError(f"output is torn in sample {first + 1}")
    if len(frames) != samples:
        raise RunError(f"output ends in sample {min(len(frames) + 1, samples)} of {samples}")
    if not np.array_equal(frames["step"], case.sample_steps):
        raise RunError("output has other time steps than the samples")
    if (frames["values"][:, :, 0] != np.arange(1, bodies + 1)).any():
        raise RunError("output has its beads in another order")
    return _columns(frames, columns)


def read_partial_dump(
    case: Case, path: Path, columns: tuple[str, ...], head: tuple[tuple[Any, ...], ...] = FRAME_HEAD
) -> dict[str, Array] | None:
    """As ``read_dump``, of the samples before a body was lost or the run ended; None where there are none."""
    try:
        frames = _frames(case, path, columns, head)
    except RunError:
        return None
    whole = np.logical_and.accumulate(_whole(case, frames, columns))[: case.scene.samples]
    return _columns(frames[: whole.sum()], columns) if whole.any() else None


def _frames(case: Case, path: Path, columns: tuple[str, ...], head: tuple[tuple[Any, ...], ...]) -> NDArray[np.void]:
    """Complete frames, whatever is in them."""
    frame = np.dtype([*head, ("values", "f8", (case.chain.bodies, len(columns)))])
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise RunError(f"no output: {error.strerror}") from error
    return np.frombuffer(raw, frame, count=len(raw) // frame.itemsize)


def _whole(case: Case, frames: NDArray[np.void], columns: tuple[str, ...]) -> NDArray[np.bool_]:
    """Which frames hold all bodies."""
    bodies = case.chain.bodies
    return np.asarray((frames["atoms"] == bodies) & (frames["count"] == bodies * len(columns)))


def _columns(frames: NDArray[np.void], columns: tuple[str, ...]) -> dict[str, Array]:
    return {name: frames["values"][:, :, place] for place, name in enumerate(columns)}


def contact_forces(lowest_N: Array, contacts_N: Array) -> Array:
    """Forces along the axis, contact by contact from the lowest up: ``F_{j+1} = F_j - f_j``.

    Args:
        lowest_N: of contact 1, zero where there is no wall. Shape (samples,).
        contacts_N: on each body by its two contacts, upwards positive. Shape (samples, bodies).

    Returns:
        Shape (samples, bodies).
    """
    return np.subtract.accumulate(np.column_stack([lowest_N, contacts_N[:, :-1]]), axis=1)
