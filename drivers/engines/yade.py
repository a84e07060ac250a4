"""YADE: deck, reader of its arrays."""

import os
import re
from collections.abc import Iterator
from math import atan
from pathlib import Path

import numpy as np

from drivers.base import decks
from drivers.base.errors import InputProblem
from drivers.base.processes import line_of
from drivers.chain.case import SIDEWAYS, STRAIGHT, Case
from drivers.chain.chain import Array, Chain
from drivers.chain.trace import Trace, make_trace
from drivers.engines import Engine, last_line
from drivers.engines._raw_output import read_arrays
from drivers.laws import HUNT_CROSSLEY, KUWABARA_KONO, POWER, VISCOELASTIC
from validation.reference.hertz_chain import loads_N
from validation.reference.tube import INCREMENTAL

COMMAND = ("yade", "-n", "-x", "chain.py")
# force of laws that YADE does not have
DISSIPATIVE = {
    HUNT_CROSSLEY: "damping * overlap * sqrt(overlap) * closing",
    KUWABARA_KONO: "damping * sqrt(overlap) * closing",
    POWER: "damping * copysign(abs(closing) ** alpha, closing)",
}
CHATTER = ("Welcome to Yade", "Using python version", "TCP python prompt", "XMLRPC info", "Running script")


def refusal(case: Case) -> InputProblem | None:
    """Refuse damped contacts that are pressed, and moving or driven, at time 0.

    YADE's velocities start half a step earlier. Laws that are computed in the deck take the closing speed of time 0 in
    the first step.
    """
    chain, driven = case.chain, _driven_N(case.chain) != 0
    along, approach = np.diff(chain.place_m, axis=0), np.diff(chain.velocity_xyz_m_s, axis=0)
    between = np.einsum("ij,ij->i", along, approach)  # contacts lean in a tube, so speeds across the axis count
    moving = np.append(chain.closing_m_s[0], between) != 0
    moving |= driven | np.append(False, driven[:-1])  # both contacts of the body
    moving &= chain.overlap_m > 0
    if chain.law.name != VISCOELASTIC or not moving.any():
        return None
    found = f"bead {int(np.argmax(moving)) + 1} pressed, and moving or driven, at time 0"
    if driven.any() or (chain.drive and chain.drive.prescribed and chain.velocity_m_s[chain.drive.body]):
        return "drive.start", found, "a later start, or contacts that are elastic"
    return "chain.bead", found, "no such velocities, or contacts that are elastic"


def _driven_N(chain: Chain) -> Array:
    """Force of the drive on each body at time 0. Shape (bodies,)."""
    return np.ravel(loads_N(chain.load_N, chain.drive, np.zeros(1))) - chain.load_N


def render(case: Case) -> decks.Deck:
    """Render ``chain.py``; velocities are given half a step before time 0, as YADE's leapfrog needs them."""
    chain, early = case.chain, case.chain.velocity_xyz_m_s
    early[:, 2] -= 0.5 * case.scene.time_step_s * (chain.acceleration_m_s2 + _driven_N(chain) / chain.mass_kg)
    bodies = list(zip(chain.place_m, chain.radius_m, chain.mass_kg, early, chain.materials, strict=True))
    text = decks.render(
        "yade/chain.py.j2",
        case=case,
        face=bodies.pop() if np.isinf(chain.radius_m[-1]) else None,
        spheres=bodies,
        materials=case.materials_by(chain.materials),
        dissipative=DISSIPATIVE.get(chain.law.name),
        friction_angle=atan(chain.friction),
    )
    return decks.Deck({"chain.py": text}, COMMAND, raw=("chain.npz",))


def read(case: Case, folder: Path) -> Trace:
    """Read the arrays as a trace, with positions and velocities shifted to the time of the forces.

    After a step YADE's positions are one step and its velocities half a step ahead of its forces, so with
    ``m a = F_j - F_{j+1} + load``: ``z_n = z - v dt`` and ``v_n = v - a dt/2``. Vectors of a straight chain have one
    component, along the axis.

    Raises:
        RunError: the file or an array is missing or incomplete.
    """
    chain, samples, step = case.chain, case.scene.samples, case.scene.time_step_s
    where, axes = ("height", ()) if chain.straight else ("place", (3,))
    names = (where, "velocity", "spin", "torque") if chain.turns else (where, "velocity")
    shapes = dict.fromkeys(names, (samples, chain.bodies, *axes))
    shapes |= {"force": (samples, chain.bodies - (chain.wall is None), *axes)}
    shapes |= {"on_bore": (samples, len(chain.guided), 3)} if chain.guided else {}
    arrays = {name: np.atleast_3d(values) for name, values in read_arrays(folder / "chain.npz", shapes).items()}
    force, by_bore = np.zeros((2, *arrays["velocity"].shape))
    force[:, int(chain.wall is None) :] = arrays["force"]
    flat = np.isinf(chain.radius_m) & (not chain.straight)
    force[:, flat] *= -1  # forces are those on the body above, but the face is the first body of its contact
    if chain.guided:
        by_bore[:, chain.guided] = arrays["on_bore"]
    acceleration = by_bore - np.diff(force, axis=1, append=0.0)
    acceleration[:, :, -1] += loads_N(chain.load_N, chain.drive, case.sample_times_s)
    acceleration /= chain.mass_kg[:, np.newaxis]
    if chain.drive is not None and chain.drive.prescribed:
        acceleration[:, chain.drive.body] *= 2.0  # its velocity was set at the time of the forces, a step before
    place = arrays[where] - step * arrays["velocity"]
    velocity = arrays["velocity"] - 0.5 * step * acceleration
    if chain.straight:
        return make_trace(chain, case.sample_times_s, force[:, :, 0], place[:, :, 0], velocity[:, :, 0])
    velocity[:, flat, :2], place[:, flat, :2] = 0.0, 0.0  # guided
    inertia = 0.4 * chain.mass_kg * chain.radius_m**2  # inf of a flat face
    spin = arrays["spin"] - 0.5 * step * arrays["torque"] / inertia[:, np.newaxis] if chain.turns else None
    return make_trace(chain, case.sample_times_s, force[:, :, 2], place, velocity, spin, by_bore)


def libraries(program: Path) -> Iterator[Path]:
    """Files that a ``yade`` script loads; the script names their folder in three parts."""
    parts = re.search(
        r"prefix,suffix='([^']*)'.*,'([^']*)'[\s\S]*?libPATH='([^']*)'", program.read_text(errors="replace")
    )
    if parts:
        prefix, suffix, folder = parts.groups()
        place = Path(os.environ.get("YADE_PREFIX", prefix), folder, f"yade{suffix}")
        yield from sorted(file for kind in ("*.so", "*.py") for file in place.rglob(kind))


ENGINE = Engine(
    how_to_get="Debian's packages yade and python3-yade",
    title="YADE",
    program="yade",
    version=lambda command: line_of(command, "--version", r"Yade version"),
    libraries=libraries,
    shear=INCREMENTAL,
    dissipation=frozenset({VISCOELASTIC, *DISSIPATIVE}),
    models=STRAIGHT | SIDEWAYS,
    refusal=refusal,
    render=render,
    server=decks.Deck({"serve.py": decks.render("serve.py.j2", code="yade")}, (*COMMAND[:-1], "serve.py"), raw=()),
    read=read,
    failure_reason=lambda stdout, stderr: last_line(stdout, stderr, CHATTER),
    style={"color": "#d55e00", "ls": (0, (4, 3)), "marker": "x", "ms": 4.0},
)
