"""Readers of raw output for all adapters: arrays, binary dumps, contact forces from forces on bodies."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.base.errors import RunError
from drivers.chain.case import Case
from drivers.chain.chain import Array

# fields of a frame of a binary dump; then follows one chunk for each process, a count and as many values
_FRAME: tuple[tuple[Any, ...], ...] = (
    ("step", "i8"),
    ("atoms", "i8"),
    ("triclinic", "i4"),
    ("boundary", "i4", 6),
    ("box", "f8", 6),
    ("columns", "i4"),
)
_MAGIC = (-10).to_bytes(8, sys.byteorder, signed=True) + b"DUMPCUSTOM"  # first bytes of frames since LAMMPS 2020


def read_arrays(path: Path, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Array]:
    """Arrays of a ``.npz`` file, or the only array of a ``.npy`` file, by name.

    Raises:
        RunError: a missing file or array, or another shape than expected.
    """
    if not path.exists():
        raise RunError(f"no output: {path.name} was not written")
    try:
        stored = np.load(path, allow_pickle=False)
        named = dict.fromkeys(shapes, stored) if isinstance(stored, np.ndarray) else stored
        arrays = {name: named[name].astype(float, casting="safe", copy=False) for name in shapes}
    except Exception as error:  # numpy and zipfile raise many kinds of errors for damaged files
        raise RunError(f"output is damaged: {path.name}: {error}") from error
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise RunError(f"output has {name} of shape {arrays[name].shape}, expected {shape}")
    return arrays


def read_dump(case: Case, path: Path, columns: tuple[str, ...]) -> dict[str, Array]:
    """Columns of a binary dump of LAMMPS or a descendant by name, each of shape (samples, bodies).

    Args:
        case: the case; its bodies are atoms 1, 2, ... from the lowest up.
        path: the dump, written by any number of processes, with frames sorted by atom.
        columns: names of the columns; the first is the atom's number.

    Raises:
        RunError: frames or bodies are missing, or the file is damaged; its ``partial`` holds the columns of the samples
            before, if there are any.
    """
    bodies, samples = case.chain.bodies, case.scene.samples
    frames, whole = _frames(path, columns, bodies)
    before = frames[: np.logical_and.accumulate(whole)[:samples].sum()]
    chunks = [before[name] for name in frames.dtype.names or () if name.startswith("values")]
    values = chunks[0] if len(chunks) == 1 else np.concatenate(chunks, axis=1)
    arrays = {name: values[:, :, place] for place, name in enumerate(columns)}
    problem = ""
    if not whole.all():
        first = int(np.argmin(whole))
        atoms = frames["atoms"][first]
        if 0 <= atoms < bodies:
            at = case.sample_times_s[min(first, samples - 1)]
            problem = f"unstable at t = {at:g} s: {atoms} bodies instead of {bodies}, one was lost"
        else:
            problem = f"output is damaged in sample {first + 1}, or its processes share the beads in another way"
    elif len(frames) != samples:
        problem = f"output ends in sample {min(len(frames) + 1, samples)} of {samples}"
    elif not np.array_equal(frames["step"], case.sample_steps):
        problem = "output has other time steps than the samples"
    elif (arrays[columns[0]] != np.arange(1, bodies + 1)).any():
        problem = "output has its beads in another order"
    if problem:
        raise RunError(problem, partial=arrays if len(before) else None)
    return arrays


def _frames(path: Path, columns: tuple[str, ...], bodies: int) -> tuple[NDArray[np.void], NDArray[np.bool_]]:
    """Frames of a dump, if all have chunks of the sizes of the first, and whether each of them is of that kind."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise RunError(f"no output: {error.strerror}") from error
    fields = [*_FRAME, ("processes", "i4")]
    if raw.startswith(_MAGIC):
        names = ("names", f"S{len(' '.join(columns))}")
        fields = [("magic", "V26"), *_FRAME, ("units", "i4"), ("timed", "i1"), ("letters", "i4"), names, fields[-1]]
    at, sizes = np.dtype(fields).itemsize, list[int]()
    processes = np.frombuffer(raw[:at], fields)["processes"] if len(raw) >= at else np.zeros(1)
    while len(sizes) < processes[0] and at + 4 <= len(raw):
        sizes.append(int(np.frombuffer(raw, "i4", 1, at)[0]))
        at += 4 + 8 * max(sizes[-1], 0)
    if sum(sizes) != bodies * len(columns):
        sizes = [bodies * len(columns)]  # the first frame is incomplete or has lost a body
    for i, size in enumerate(sizes):
        fields += [(f"count{i}", "i4"), (f"values{i}", "f8", (size // len(columns), len(columns)))]
    frames = np.frombuffer(raw, fields, count=len(raw) // np.dtype(fields).itemsize)
    whole = (frames["atoms"] == bodies) & (frames["processes"] == len(sizes))
    for i, size in enumerate(sizes):
        whole &= frames[f"count{i}"] == size
    return frames, np.asarray(whole)


def contact_forces(lowest_N: Array, contacts_N: Array) -> Array:
    """Contact forces along the axis from the lowest contact upwards: ``F_{j+1} = F_j - f_j``.

    Args:
        lowest_N: force of contact 1, zero without a wall. Shape (samples,).
        contacts_N: force on each body by its two contacts, upwards positive. Shape (samples, bodies).

    Returns:
        Contact forces, compression positive. Shape (samples, bodies).
    """
    force = np.empty_like(contacts_N)
    force[:, 0] = lowest_N
    np.negative(contacts_N[:, :-1], out=force[:, 1:])
    return np.cumsum(force, axis=1, out=force)
