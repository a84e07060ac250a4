"""Raw output that is a ``.npz`` of plain arrays."""

from pathlib import Path

import numpy as np

from drivers.chain import Array
from drivers.errors import RunError


def load_arrays(path: Path, shapes: dict[str, tuple[int, int]]) -> dict[str, Array]:
    """The arrays of a file, of the expected shapes.

    Raises:
        RunError: the file, an array or part of it is missing.
    """
    if not path.exists():
        raise RunError(f"no output: {path.name} was not written")
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name].astype(float, casting="safe") for name in shapes}
    except Exception as error:  # a torn file can make numpy and zipfile raise almost anything
        raise RunError(f"output is torn: {path.name}: {error}") from error
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise RunError(f"output has {name} of shape {arrays[name].shape}, expected {shape}")
    return arrays
