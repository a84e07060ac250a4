"""Raw output that is a ``.npz`` of plain arrays."""

import zipfile
from pathlib import Path

import numpy as np

from drivers.errors import RunError
from drivers.trace import Array


def load_arrays(path: Path, shapes: dict[str, tuple[int, int]]) -> dict[str, Array]:
    """The arrays of a file, of the expected shapes.

    Raises:
        RunError: the file, an array or part of it is missing.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: np.asarray(stored[name], dtype=float) for name in shapes}
    except FileNotFoundError as error:
        raise RunError(f"no output: {path.name} was not written") from error
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise RunError(f"output is torn: {path.name}: {error}") from error
    for name, shape in shapes.items():
        if arrays[name].shape != shape:
            raise RunError(f"output has {name} of shape {arrays[name].shape}, expected {shape}")
    return arrays
