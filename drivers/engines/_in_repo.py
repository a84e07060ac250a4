"""What the two in-repo engines share: their deck is the chain's arrays, their program ``validation.reference``."""

import hashlib
import json
import sys
from importlib.metadata import version as package_version
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import paths
from drivers.base.decks import Deck
from drivers.base.errors import InputProblem
from drivers.chain.case import Case
from drivers.chain.trace import Trace, make_trace
from drivers.engines import Engine, _in_repo_tube
from drivers.engines._arrays import load_array

COMMAND = ("python", "-m", "validation.reference", "chain.json")


def version(executable: Path) -> str:
    """Digest of the integrators' source, with the versions of what they compute with."""
    digest = hashlib.sha256()
    for source in sorted((paths.ROOT / "validation" / "reference").glob("*.py")):
        digest.update(source.read_bytes())
    libraries = " ".join(f"{name} {package_version(name)}" for name in ("numpy", "scipy", "numba"))
    return f"source {digest.hexdigest()[:12]}, {libraries}"


def render(case: Case, method: str, **timing: float) -> Deck:
    """``chain.json``: the command, the method with its timing, and the chain's arrays."""
    scene, chain = case.scene, case.chain
    values = {
        "command": " ".join(COMMAND),
        "summary": f"{case.summary}; bodies from the lowest up, contact j under body j, upwards positive, SI units",
        "method": method,
        **timing,
        "samples": scene.samples,
        "mass_kg": chain.mass_kg.tolist(),
        "stiffness_N_m-3/2": chain.stiffness.tolist(),
        "overlap_m": chain.overlap_m.tolist(),
        "velocity_m_s": chain.velocity_m_s.tolist(),
        "load_N": chain.load_N.tolist(),
        **({"damping_N_s_m-5/4": chain.damping.tolist()} if chain.damping_ratio else {}),
        "height_m": chain.height_m.tolist(),  # not integrated, but part of what the run reports
        "diameter_m": [None if np.isinf(radius) else 2 * radius for radius in chain.radius_m],
        **(_in_repo_tube.values_of(case, chain.lateral) if chain.lateral else {}),
    }
    lines = ",\n".join(f"{json.dumps(key)}: {json.dumps(value)}" for key, value in values.items())
    return Deck({"chain.json": f"{{{lines}}}\n"}, COMMAND, raw=("chain.npy",))


def read(case: Case, folder: Path) -> Trace:
    """The arrays as a trace.

    Raises:
        RunError: the file or part of it is missing.
    """
    if case.chain.lateral is not None:
        return _in_repo_tube.read(case, case.chain.lateral, folder)
    force, displacement, velocity = load_array(folder / "chain.npy", (3, case.scene.samples, case.chain.bodies))
    height = case.chain.height_m + displacement
    return make_trace(case.chain, case.sample_times_s, force, height, velocity)


def refusal(case: Case) -> InputProblem | None:
    """A three-dimensional chain in a bore of flat sides; it takes every straight one."""
    return _in_repo_tube.refusal(case)


def in_repository_engine(**own: Any) -> Engine:
    """An in-repo engine, from what is its own."""
    return Engine(
        how_to_get="nothing: it is part of this repository",
        find=lambda: Path(sys.executable),
        version=version,
        in_repository=True,
        variables={"PYTHONPATH": str(paths.ROOT)},
        refusal=refusal,
        server=Deck({}, ("python", "-m", "validation.reference", "-"), raw=()),  # takes requests from stdin
        read=read,
        loop_pattern=r"^completed \d+ samples in ([0-9.]+) s$",
        **own,
    )
