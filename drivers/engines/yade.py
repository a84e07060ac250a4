"""YADE: renders its deck, reads its arrays."""

import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.base.decks import Deck
from drivers.base.decks import render as render_template
from drivers.base.errors import RunError
from drivers.base.messages import Complaint
from drivers.base.processes import UNKNOWN_VERSION, first_line_of
from drivers.chain.case import Case
from drivers.chain.elements import SIDEWAYS, STRAIGHT
from drivers.chain.trace import Trace, make_trace
from drivers.engines import IN_HEIGHTS, INCREMENTAL, _yade_tube
from drivers.engines._arrays import load_arrays
from drivers.engines._yade_values import common_values, staggered_velocities

HOW_TO_GET = "Debian's packages yade and python3-yade"
IN_REPOSITORY = False
SCHEME = IN_HEIGHTS
SHEAR = INCREMENTAL
MODELS = STRAIGHT | SIDEWAYS
LOST = ""
VARIABLES: dict[str, str] = {}
COMMAND = ("yade", "-n", "-x", "chain.py")
SERVER = Deck({"serve.py": render_template("yade/serve.py.j2")}, ("yade", "-n", "-x", "serve.py"), raw=())
CHATTER = ("Welcome to Yade", "Using python version", "TCP python prompt", "XMLRPC info", "Running script")


@dataclass(frozen=True)
class Body:
    """A bead, a striker, or its face."""

    height: float
    radius: float
    mass: float
    velocity: float
    material: str


def find() -> Path | None:
    """Path of the executable."""
    path = shutil.which("yade")
    return Path(path) if path else None


def version(executable: Path) -> str:
    """Such as ``2023.02a``."""
    match = re.search(r"Yade version: ([^\s,]+)", first_line_of((str(executable), "--version")))
    return match.group(1) if match else UNKNOWN_VERSION


def render(case: Case) -> Deck:
    """``chain.py``."""
    chain = case.chain
    if chain.lateral is not None:
        return Deck({"chain.py": _yade_tube.render(case)}, COMMAND, raw=("chain.npz",))
    staggered = staggered_velocities(case)
    bodies = [
        Body(chain.height_m[i], chain.radius_m[i], chain.mass_kg[i], staggered[i], chain.materials[i])
        for i in range(chain.bodies)
    ]
    flat = bodies.pop() if np.isinf(chain.radius_m[-1]) else None
    geometries = ["Ig2_Sphere_Sphere_ScGeom()"] if len(bodies) > 1 else []
    if chain.wall or flat:
        geometries.append("Ig2_Wall_Sphere_ScGeom(hertzian=True)")
    text = render_template(
        "yade/chain.py.j2",
        **common_values(case),
        spheres=bodies,
        flat=flat,
        geometries=geometries,
    )
    return Deck({"chain.py": text}, COMMAND, raw=("chain.npz",))


def request(folder: str, word: str) -> str:
    """A line for ``serve.py``."""
    return f"{folder} {word}\n"


def read(case: Case, folder: Path) -> Trace:
    """The arrays as a trace, brought to the time of the forces.

    After a step YADE's positions are one step and its velocities half a step ahead of its forces, so with
    ``m a = F_j - F_{j+1} + load``: ``z_n = z - v dt`` and ``v_n = v - a dt/2``.

    Raises:
        RunError: the file or part of it is missing.
    """
    trace = _straight(case, folder) if case.chain.lateral is None else _yade_tube.read(case, folder)
    try:
        completed = loop_seconds((folder / "stdout.txt").read_text(errors="replace")) is not None
    except OSError as error:
        raise RunError(f"no stdout: {error.strerror}") from error
    if not completed:
        raise RunError("the deck's closing line is missing: it did not run to its end")
    return trace


def _straight(case: Case, folder: Path) -> Trace:
    chain, step = case.chain, case.scene.time_step_s
    contacts = chain.bodies - (chain.wall is None)
    shapes = {"force": contacts, "height": chain.bodies, "velocity": chain.bodies}
    arrays = load_arrays(folder / "chain.npz", {name: (case.scene.samples, n) for name, n in shapes.items()})
    force = arrays["force"]
    if chain.wall is None:
        force = np.column_stack([np.zeros(len(force)), force])
    acceleration = (force - np.column_stack([force[:, 1:], np.zeros(len(force))]) + chain.load_N) / chain.mass_kg
    height = arrays["height"] - step * arrays["velocity"]
    velocity = arrays["velocity"] - 0.5 * step * acceleration
    return make_trace(chain, case.sample_times_s, force, height, velocity)


def refusal(case: Case) -> Complaint | None:
    """Damped contacts that are pressed and moving at time 0: its velocities begin half a step before."""
    chain = case.chain
    closing = np.append(0.0, chain.velocity_m_s[:-1]) - chain.velocity_m_s
    moving = (chain.overlap_m > 0) & (closing != 0)
    if not chain.damping_ratio or not moving.any():
        return None
    found = f"bead {int(np.argmax(moving)) + 1} pressed and moving at time 0"
    return "chain.bead", found, "no such velocities, or contacts that are elastic"


def seen(case: Case, folder: Path) -> Trace | None:
    """None: it writes when it ends."""
    return None


def complaint(stdout: str, stderr: str) -> str:
    """The exception's line, the last that is not YADE's chatter."""
    lines = [line.strip() for line in (stdout + "\n" + stderr).splitlines() if line.strip()]
    telling = [line for line in lines if not line.startswith(CHATTER)]
    return (telling or lines or ["no output"])[-1]


def loop_seconds(stdout: str) -> float | None:
    """From the closing line ``completed 8001 steps in 0.12 s``."""
    match = re.search(r"^completed \d+ steps in ([0-9.]+) s$", stdout, re.MULTILINE)
    return float(match.group(1)) if match else None
