"""In-repo engines: they integrate cases in this process; by hand ``validation.reference`` runs the same deck."""

import json
from collections.abc import Callable
from importlib.metadata import version as package_version
from math import isinf
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import paths
from drivers.base.cache import content_of
from drivers.base.decks import Deck
from drivers.chain.case import Case
from drivers.chain.chain import tube_arrays_of
from drivers.chain.schemes import trace_of
from drivers.chain.trace import Trace
from drivers.engines import Engine
from drivers.engines._raw_output import read_arrays
from drivers.laws import LAWS
from validation import reference
from validation.reference import columns_of, timed
from validation.reference.hertz_chain import TUBE_KEYS, VISCOELASTIC_POWER, Flag, Motion, TubeMotion

COMMAND = ("python", "-m", reference.__name__, "chain.json")
COLUMNS = 13  # three-dimensional chain: axial force; bore force, position, velocity and spin with three each
Values = dict[str, Any]  # of a deck, by key


def version(command: tuple[str, ...]) -> str:
    """Digest of the integrators' source, with versions of their libraries."""
    digest = content_of((paths.ROOT / "validation" / "reference").glob("*.py"))  # runs survive all other changes
    libraries = " ".join(f"{name} {package_version(name)}" for name in ("numpy", "scipy", "numba"))
    return f"source {digest[:12]}, {libraries}"


def _values(case: Case, method: str, timing: Values) -> Values:
    """Values of the deck: the command, the method with its timing, and the chain's arrays."""
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
    }
    if chain.law.alpha:
        values |= {"gamma_N_(s/m)^alpha": chain.damping, "alpha": chain.law.alpha}
    elif chain.damped and chain.law.overlap_power == VISCOELASTIC_POWER:
        values |= {"damping_N_s_m-5/4": chain.damping}
    elif chain.damped:
        values |= {"damping_N_s_m-(1+p)": chain.damping, "overlap_power": chain.law.overlap_power}
    if chain.drive is not None:
        given = "displacement of" if chain.drive.prescribed else "force on"
        values |= {"driven_body": chain.drive.body + 1, "drive": f"{given} the body"}
        values |= {"drive_segments": chain.drive.segments}
    values |= {
        "height_m": chain.height_m,  # not integrated, but used for the trace
        "diameter_m": [None if isinf(diameter) else diameter for diameter in (2 * chain.radius_m).tolist()],
    }
    if not chain.straight:
        arrays = tube_arrays_of(chain)
        values |= {key: getattr(arrays, field) for field, key in TUBE_KEYS.items()}
    return values


def read(case: Case, folder: Path) -> Trace:
    """Read the output array of a deck run by hand as a trace.

    Raises:
        RunError: the file is missing or incomplete.
    """
    shape = (3 if case.chain.straight else COLUMNS, case.scene.samples, case.chain.bodies)
    return _trace(case, read_arrays(folder / "chain.npy", {"an array": shape})["an array"])


def _trace(case: Case, columns: Any) -> Trace:
    """Trace of the columns of an output."""
    if case.chain.straight:
        return trace_of(case, case.sample_times_s, Motion(*columns))
    bore, place, velocity, spin = np.moveaxis(np.reshape(columns[1:], (4, 3, *columns[0].shape)), 1, 3)
    return trace_of(case, case.sample_times_s, TubeMotion(columns[0], bore, place, velocity, spin))


def in_repository_engine(method: str, timing: Callable[[Case], Values], **fields: Any) -> Engine:
    """Build an in-repo engine with further ``fields``.

    Args:
        method: integrator, as named in the deck.
        timing: function that returns the time step or tolerance of a case, and the spacing of its samples, for the
            deck.
        fields: further fields of ``Engine``.
    """

    def render(case: Case) -> Deck:
        """Render ``chain.json``."""
        values = _values(case, method, timing(case)).items()
        lines = (f"{json.dumps(key)}: {json.dumps(value, default=np.ndarray.tolist)}" for key, value in values)
        return Deck({"chain.json": "{" + ",\n".join(lines) + "}\n"}, COMMAND, raw=("chain.npy",))

    def integrate(case: Case, stop: Flag) -> tuple[Trace, float]:
        """Trace of a case, and the time of the loop in s, without that of loading or compiling it."""
        motion, loop_s = timed(_values(case, method, timing(case)), stop)
        if isinstance(motion, Motion):  # with the work of a drive, which is no column
            return trace_of(case, case.sample_times_s, motion), loop_s
        return _trace(case, columns_of(motion)), loop_s  # by columns, as of a deck: sums have the same rounding errors

    return Engine(
        how_to_get="nothing: it is part of this repository",
        program="python",
        version=version,
        dissipation=frozenset(LAWS),
        render=render,
        integrate=integrate,
        server=Deck({}, (*COMMAND[:-1], "-"), raw=()),  # reads requests from stdin
        read=read,
        **fields,
    )
