"""In-repo engines: their deck holds the chain's arrays, their program is ``validation.reference``."""

import hashlib
import json
from importlib.metadata import version as package_version
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import paths
from drivers.base.decks import Deck
from drivers.chain.case import Case
from drivers.chain.chain import tube_arrays_of
from drivers.chain.schemes import trace_of
from drivers.chain.trace import Trace, make_trace
from drivers.engines import Engine
from drivers.engines._raw_output import read_arrays
from drivers.scene.model import POWER, VISCOELASTIC
from validation import reference
from validation.reference.hertz_chain import TUBE_KEYS, Motion

COMMAND = ("python", "-m", reference.__name__, "chain.json")
COLUMNS = 13  # three-dimensional chain: axial force; bore force, position, velocity and spin with three each


def version(command: tuple[str, ...]) -> str:
    """Digest of the integrators' source, with versions of their libraries."""
    digest = hashlib.sha256()
    for source in sorted((paths.ROOT / "validation" / "reference").glob("*.py")):
        digest.update(source.read_bytes())
    libraries = " ".join(f"{name} {package_version(name)}" for name in ("numpy", "scipy", "numba"))
    return f"source {digest.hexdigest()[:12]}, {libraries}"


def render(case: Case, method: str, **timing: float) -> Deck:
    """``chain.json``: the command, the method with its timing, and the chain's arrays."""
    chain = case.chain
    values = {
        "command": " ".join(COMMAND),
        "summary": f"{case.summary}; bodies from the lowest up, contact j under body j, upwards positive, SI units",
        "method": method,
        **timing,
        "samples": case.scene.samples,
        "mass_kg": chain.mass_kg,
        "stiffness_N_m-3/2": chain.stiffness,
        "overlap_m": chain.overlap_m,
        "velocity_m_s": chain.velocity_m_s,
        "load_N": chain.load_N,
        **({"damping_N_s_m-5/4": chain.damping} if chain.damping_ratio else {}),
        **({"gamma_N_(s/m)^alpha": chain.damping, "alpha": chain.alpha} if chain.gamma else {}),
        "height_m": chain.height_m,  # not integrated, but used for the trace
        "diameter_m": [None if np.isinf(radius) else 2 * radius for radius in chain.radius_m],
    }
    if chain.lateral is not None:
        arrays = tube_arrays_of(chain)
        values |= {key: getattr(arrays, field) for field, key in TUBE_KEYS.items()}
    lines = (f"{json.dumps(key)}: {json.dumps(value, default=np.ndarray.tolist)}" for key, value in values.items())
    return Deck({"chain.json": "{" + ",\n".join(lines) + "}\n"}, COMMAND, raw=("chain.npy",))


def read(case: Case, folder: Path) -> Trace:
    """Read the output array as a trace.

    Raises:
        RunError: the file is missing or incomplete.
    """
    chain, times = case.chain, case.sample_times_s
    shape = (COLUMNS if chain.lateral else 3, case.scene.samples, chain.bodies)
    columns = read_arrays(folder / "chain.npy", {"an array": shape})["an array"]
    if chain.lateral is None:
        return trace_of(case, times, Motion(*columns))
    bore, place, velocity, spin = np.moveaxis(columns[1:].reshape(4, 3, *shape[1:]), 1, 3)
    return make_trace(chain, times, columns[0], place, velocity, spin, bore)


def in_repository_engine(kernels: str, **own: Any) -> Engine:
    """Build an in-repo engine with ``own`` fields; its server loads the module ``kernels`` before the first case."""
    return Engine(
        how_to_get="nothing: it is part of this repository",
        program="python",
        version=version,
        in_repository=True,
        variables={"PYTHONPATH": str(paths.ROOT)},
        dissipation=frozenset({VISCOELASTIC, POWER}),
        server=Deck({}, (*COMMAND[:-1], "-", kernels), raw=()),  # reads requests from stdin
        read=read,
        loop_pattern=r"^completed \d+ samples in ([0-9.]+) s$",
        **own,
    )
