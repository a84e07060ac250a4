"""Raw output that is plain arrays: a ``.npy``, or a ``.npz`` of several."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base.errors import RunError
from drivers.chain.chain import Array


def load_array(path: Path, shape: tuple[int, ...]) -> Array:
    """The array of a ``.npy``, of the expected shape.

    Raises:
        RunError: the file or part of it is missing.
    """
    return _checked(path, {"an array": shape}, lambda: {"an array": np.load(path, allow_pickle=False)})["an array"]


def load_arrays(path: Path, shapes: dict[str, tuple[int, ...]]) -> dict[str, Array]:
    """The arrays of a ``.npz``, of the expected shapes.

    Raises:
        RunError: the file, an array or part of it is missing.
    """

    def read() -> dict[str, Any]:
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in shapes}

    return _checked(path, shapes, read)


def _checked(path: Path, shapes: dict[str, tuple[int, ...]], read: Callable[[], dict[str, Any]]) -> dict[str, Array]:
    if not path.exists():
        raise RunError(f"no output: {path.name} was not written")
    try:
        arrays = {name: array.astype(float, casting="safe", copy=False) for name, array in read().items()}
    except Exception as error:  # a torn file can make numpy and zipfile raise almost anything
        raise RunError(f"output is torn: {path.name}: {error}") from error
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise RunError(f"output has {name} of shape {arrays[name].shape}, expected {shape}")
    return arrays
