"""Readers of raw output for all adapters: arrays, binary dumps, contact forces from forces on bodies."""

import struct
import sys
from collections.abc import Mapping
from contextlib import suppress
from itertools import groupby
from operator import itemgetter
from pathlib import Path

import numpy as np

from drivers.base.errors import RunError
from drivers.chain.case import Case
from drivers.chain.chain import Array

# head of a frame of a binary dump: step, number of atoms, 80 bytes of boundary and box, number of processes; since
# LAMMPS of 2020 a mark comes first, and 9 bytes and the names of the columns come before the number of processes; then
# follows a chunk for each process: a count and as many values
_MARK = (-10).to_bytes(8, sys.byteorder, signed=True) + b"DUMPCUSTOM"
_MARKED, _PLAIN, _COUNT = "=26x2q89x{}xi", "=2q80xi", struct.Struct("=i")


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
    bodies, samples, width = case.chain.bodies, case.scene.samples, len(columns)
    try:
        raw = memoryview(path.read_bytes())
    except OSError as error:
        raise RunError(f"no output: {error.strerror}") from error
    head = _MARKED.format(len(" ".join(columns))) if raw[: len(_MARK)] == _MARK else _PLAIN
    parts, steps, at, problem = [np.empty((0, bodies, width))], list[int](), 0, ""
    with suppress(struct.error):  # the last frame is incomplete
        while at < len(raw):
            _, atoms, processes = struct.unpack_from(head, raw, at)
            frame, chunks = _frame(raw, at, head, processes)
            whole = raw[at : len(raw) - (len(raw) - at) % frame.size]
            size = sum(chunk.stop - chunk.start for chunk in chunks)
            if atoms != bodies or size != 8 * bodies * width or not whole:
                if 0 < atoms < bodies:
                    when = case.sample_times_s[min(len(steps), samples - 1)]
                    problem = f"unstable at t = {when:g} s: {atoms} bodies instead of {bodies}, one was lost"
                break
            _, alike = next(groupby(frame.iter_unpack(whole), itemgetter(slice(1, None))))
            numbers = [step for step, *_ in alike]
            steps += numbers
            block = np.frombuffer(whole, np.uint8).reshape(-1, frame.size)[: len(numbers)]
            values = np.concatenate([block[:, chunk] for chunk in chunks], axis=1).view(float)
            parts.append(values.reshape(-1, bodies, width))
            at += block.size
    by_body = parts[1] if len(parts) == 2 else np.concatenate(parts)
    arrays = {name: by_body[:samples, :, place] for place, name in enumerate(columns)}
    if not problem:
        if len(steps) != samples:
            problem = f"output ends in sample {min(len(steps) + 1, samples)} of {samples}, or is damaged there"
        elif steps != [*range(0, case.scene.steps + 1, case.scene.steps_per_sample)]:
            problem = "output has other time steps than the samples"
        elif (arrays[columns[0]] != np.arange(1, bodies + 1)).any():
            problem = "output has its beads in another order"
    if problem:
        raise RunError(problem, partial=arrays if steps else None)
    return arrays


def _frame(raw: memoryview, at: int, head: str, processes: int) -> tuple[struct.Struct, list[slice]]:
    """Format of the frame at a place of a dump, and the bytes of the frame with the values of each process."""
    chunks, end = list[slice](), struct.calcsize(head)
    for _ in range(processes):
        begin = end + _COUNT.size
        end = begin + 8 * max(_COUNT.unpack_from(raw, at + end)[0], 0)
        chunks.append(slice(begin, end))
    return struct.Struct(head + "".join(f"i{chunk.stop - chunk.start}x" for chunk in chunks)), chunks


def contact_forces(lowest_N: Array, contacts_N: Array) -> Array:
    """Contact forces along the axis from the lowest contact upwards: ``F_{j+1} = F_j - f_j``.

    Args:
        lowest_N: force of contact 1, zero without a wall. Shape (samples,).
        contacts_N: force on each body by its two contacts, upwards positive. Shape (samples, bodies).

    Returns:
        Contact forces, compression positive. Shape (samples, bodies).
    """
    force = np.column_stack([lowest_N, -contacts_N[:, :-1]])
    return np.cumsum(force, axis=1, out=force)
