"""Readers of raw output for all adapters: arrays, and dumps of LAMMPS and its descendants."""

import re
import struct
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import groupby
from math import isclose
from operator import itemgetter
from pathlib import Path

import numpy as np

from drivers.base.errors import RunError
from drivers.base.units import quantity
from drivers.chain.case import ALL_DIGITS, Case
from drivers.chain.chain import Array

# head of a frame of a binary dump: step, number of atoms, boundary and box, number of columns, number of processes;
# since LAMMPS of 2020 a mark of 26 bytes comes first, and units, time and names of the columns come before the number
# of processes; then follows a chunk for each process: a count and as many values
_MARK = (-10).to_bytes(8, sys.byteorder, signed=True) + b"DUMPCUSTOM"
_COUNT = struct.Struct("=i")
_SECTION = b"ITEM: "  # begins the parts of a text dump
_STEP = re.compile(r"^[ \t]*timestep[ \t]+(\d*\.?\d+(?:[eE][+-]?\d+)?)", re.MULTILINE)
LARGEST_DECK = 1_000_000  # bytes of a file of a deck


# frames of a dump that follow each other: their steps, names of the columns if the file tells them, values of shape
# (frames, atoms, columns), significant digits
_Frames = tuple[list[int], tuple[str, ...], Array, int]


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


def read_dump(case: Case, path: Path, names: Sequence[str], *, named: bool = False) -> tuple[dict[str, Array], int]:
    """Read a dump, binary or text, with atoms in any order.

    Args:
        case: the case; its bodies are the atoms in the order of their heights at time 0, without a column ``z`` in the
            order of their numbers.
        path: the dump, written by any number of processes.
        names: names of the columns, if the file does not tell them.
        named: True if these names replace those of the file.

    Returns:
        Columns by name, from the lowest body up, each of shape (samples, bodies); the number of significant digits.

    Raises:
        KeyError: the dump has no column ``id``.
        RunError: frames, atoms or columns are not those of the case, or the file is damaged; its ``partial`` holds the
            columns of the samples before, if there are any.
    """
    raw = _content_of(path)
    bodies, samples = case.chain.bodies, case.scene.samples
    steps, parts, digits, problem, own = list[int](), list[Array](), 0, "", tuple(names)
    with suppress(struct.error, IndexError, ValueError):  # the last frame is incomplete
        frames = _text_frames(raw) if raw[: len(_SECTION)] == _SECTION else _binary_frames(raw)
        for numbers, in_file, values, precise in frames:
            atoms, width = values.shape[1:]
            own = in_file if in_file and not named else own
            if steps and atoms < bodies:
                when = case.sample_times_s[min(len(steps), samples - 1)]
                problem = f"unstable at t = {when:g} s: {atoms} bodies instead of {bodies}, one was lost"
            elif atoms != bodies:
                problem = f"{path.name} has {atoms} atoms, expected {bodies}"
            elif width != len(own):
                expected = f"expected {len(own)} ({' '.join(own)}); name them: --columns"
                problem = f"{path.name} has {width} columns, {expected}"
            elif len({*own}) < width:
                problem = f"{path.name} has two columns of one name: {' '.join(own)}; name them: --columns"
            if problem:
                break
            steps += numbers
            parts.append(values)
            digits = max(digits, precise)
    problem = problem or _other_times(case, path, steps)
    if not steps:
        raise RunError(problem)
    whole = parts[0] if len(parts) == 1 else np.concatenate(parts)
    columns = _in_order(path, {name: whole[:samples, :, place] for place, name in enumerate(own)})
    if problem:
        raise RunError(problem, partial=columns)
    return columns, digits


def _content_of(path: Path) -> memoryview:
    """Content of a dump, or of its files of a frame each; RunError with the names of other dumps if there is none."""
    try:
        if found := files_of(path):
            return memoryview(b"".join(file.read_bytes() for file in found))
    except OSError as error:
        raise RunError(f"no output: {path.name}: {error.strerror}") from error
    others = [file.name for file in sorted(path.parent.glob("*")) if file.is_file() and _is_dump(file)]
    raise RunError(f"no output: {path.name} not found" + (f"; found {others[0]}: --dump {others[0]}" if others else ""))


def files_of(dump: Path) -> list[Path]:
    """Files of a dump by step, if its name has a ``*``; else the dump, if it exists."""
    found = dump.parent.glob(dump.name) if "*" in dump.name else filter(Path.is_file, [dump])
    return sorted(found, key=lambda file: [*map(int, re.findall(r"\d+", file.name))])


def _is_dump(file: Path) -> bool:
    with open(file, "rb") as opened:
        return opened.read(len(_MARK)).startswith((_MARK, _SECTION))


def _binary_frames(raw: memoryview) -> Iterator[_Frames]:
    """Frames of a binary dump.

    Raises:
        struct.error: the file ends within a frame, or is damaged.
    """
    at = 0
    while at < len(raw):
        head, names = _head(raw[at:])  # the first one may have more words
        _, atoms, processes = struct.unpack_from(head, raw, at)
        frame, chunks = _frame(raw, at, head, processes)
        whole = raw[at : len(raw) - (len(raw) - at) % frame.size]
        width, rest = divmod(sum(chunk.stop - chunk.start for chunk in chunks), 8 * max(atoms, 1))
        if rest or not whole or atoms < 1:
            return
        _, alike = next(groupby(frame.iter_unpack(whole), itemgetter(slice(1, None))))
        numbers = [step for step, *_ in alike]
        block = np.frombuffer(whole, np.uint8).reshape(-1, frame.size)[: len(numbers)]
        values = np.concatenate([block[:, chunk] for chunk in chunks], axis=1).view(float)
        yield numbers, names, values.reshape(-1, atoms, width), ALL_DIGITS
        at += block.size


def _head(raw: memoryview) -> tuple[str, tuple[str, ...]]:
    """Format of the heads of a binary dump, with step, atoms and processes; names of its columns if it tells them."""
    marked = raw[: len(_MARK)] == _MARK
    begin, names = 26 * marked, tuple[str, ...]()
    at = begin + 16 + 28 + 24 * (3 if _COUNT.unpack_from(raw, begin + 16)[0] else 2) + 4  # the box may be triclinic
    if marked:
        at += 4 + _COUNT.unpack_from(raw, at)[0]  # units
        at += 1 + 8 * bool(raw[at])  # time
        length = _COUNT.unpack_from(raw, at)[0]
        at += 4 + length
        names = tuple(bytes(raw[at - length : at]).decode(errors="replace").split())
    return f"={begin}x2q{at - begin - 16}xi", names


def _frame(raw: memoryview, at: int, head: str, processes: int) -> tuple[struct.Struct, list[slice]]:
    """Format of the frame at a place of a dump, and the bytes of the frame with the values of each process."""
    chunks, end = list[slice](), struct.calcsize(head)
    for _ in range(processes):
        begin = end + _COUNT.size
        end = begin + 8 * max(_COUNT.unpack_from(raw, at + end)[0], 0)
        chunks.append(slice(begin, end))
    return struct.Struct(head + "".join(f"i{chunk.stop - chunk.start}x" for chunk in chunks)), chunks


def _text_frames(raw: memoryview) -> Iterator[_Frames]:
    """Frames of a text dump.

    Raises:
        ValueError: the file ends within a frame, or is damaged.
    """
    step = atoms = 0
    for section in bytes(raw).decode(errors="replace").split(_SECTION.decode())[1:]:
        heading, _, content = section.partition("\n")
        if heading.startswith("TIMESTEP"):
            step = int(content)
        elif heading.startswith("NUMBER OF ATOMS"):
            atoms = int(content)
        elif heading.startswith("ATOMS"):
            names, words = tuple(heading.split()[1:]), content.split()
            reals = (word.partition("e")[0] for word in words if "." in word)
            digits = max((len(real.lstrip("-0.").replace(".", "")) for real in reals), default=0)
            numbers = [float(word) if word[-1].isdigit() else np.nan for word in words]  # some name elements
            yield [step], names, np.reshape(numbers, (1, atoms, len(names))), digits


def _in_order(path: Path, columns: dict[str, Array]) -> dict[str, Array]:
    """Columns with the atoms of each frame in the order of their numbers, and of their heights at time 0."""
    ids = columns["id"]
    order = np.argsort(ids, axis=1, kind="stable")
    if len({*ids[0]}) < ids.shape[1] or (np.take_along_axis(ids, order, 1) != np.sort(ids[0])).any():
        raise RunError(f"output is damaged: {path.name} has an atom twice, or other atoms in some frames")
    if "z" in columns:
        order = order[:, np.argsort(columns["z"][0, order[0]], kind="stable")]
    if (order == np.arange(ids.shape[1])).all():
        return columns
    return {name: np.take_along_axis(column, order, 1) for name, column in columns.items()}


def _other_times(case: Case, path: Path, steps: Sequence[int]) -> str:
    """Message on frames that are missing, or at other times than the samples, with the settings that fit them."""
    scene = case.scene
    expected = range(0, scene.steps + 1, scene.steps_per_sample)
    if [*steps] == [*expected]:
        return ""
    if [*steps] == [*expected][: len(steps)]:
        return f"output ends in sample {len(steps) + 1} of {scene.samples}, or is damaged there: {path.name}"
    step_s = _time_step(path.parent) or _time_step(path.parent.parent) or scene.time_step_s
    allowed = _listed(expected, scene.time_step_s)
    message = f"{path.name} has frames at steps {_listed(steps, step_s)}; the scene has {allowed}"
    every = steps[-1] // (len(steps) - 1) if len(steps) > 1 else 0
    if every < 1 or [*steps] != [*range(0, steps[-1] + 1, every)]:
        frame = next(i for i, step in enumerate(steps) if [step] != [*expected[i : i + 1]])
        return f"{message}; frame {frame + 1} is of step {steps[frame]} (reset_timestep 0 at the impact)"
    now = {"time_step": scene.time_step_s, "sample_interval": scene.run.sample_interval, "duration": case.duration_s}
    has = {"time_step": step_s, "sample_interval": every * step_s, "duration": steps[-1] * step_s}
    other = {key: float(f"{value:.12g}") for key, value in has.items() if not isclose(value, now[key], rel_tol=1e-9)}
    return " ".join([f"{message}:", *(f"--set run.{key}='{quantity(value, 's')}'" for key, value in other.items())])


def _listed(steps: Sequence[int], step_s: float) -> str:
    """The first steps, and the last, with their length."""
    some = [*map(str, steps[:2]), *(["..."] if len(steps) > 3 else []), *map(str, steps[2:][-1:])]
    return f"{', '.join(some)} of {quantity(step_s, 's')}"


def _time_step(folder: Path) -> float | None:
    """Time step of the decks in a folder, if they tell one."""
    small = (file for file in folder.glob("*") if file.is_file() and file.stat().st_size < LARGEST_DECK)
    told = {float(step) for file in small for step in _STEP.findall(file.read_text(errors="replace"))}
    return told.pop() if len(told) == 1 else None
