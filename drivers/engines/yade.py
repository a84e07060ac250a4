"""YADE: renders its deck, reads its arrays."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drivers.base.decks import Deck
from drivers.base.decks import render as render_template
from drivers.base.errors import InputProblem, RunError
from drivers.base.processes import find_program, version_in_words
from drivers.chain.case import Case
from drivers.chain.elements import SIDEWAYS, STRAIGHT
from drivers.chain.trace import Trace, make_trace
from drivers.engines import IN_HEIGHTS, INCREMENTAL, Engine, Style, _yade_tube, last_line
from drivers.engines._arrays import load_arrays
from drivers.engines._yade_values import common_values, staggered_velocities

COMMAND = ("yade", "-n", "-x", "chain.py")
CHATTER = ("Welcome to Yade", "Using python version", "TCP python prompt", "XMLRPC info", "Running script")


@dataclass(frozen=True)
class Body:
    """A bead, a striker, or its face."""

    height: float
    radius: float
    mass: float
    velocity: float
    material: str


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


def read(case: Case, folder: Path) -> Trace:
    """The arrays as a trace, brought to the time of the forces.

    After a step YADE's positions are one step and its velocities half a step ahead of its forces, so with
    ``m a = F_j - F_{j+1} + load``: ``z_n = z - v dt`` and ``v_n = v - a dt/2``.

    Raises:
        RunError: the file or part of it is missing.
    """
    trace = _straight(case, folder) if case.chain.lateral is None else _yade_tube.read(case, folder)
    try:
        completed = ENGINE.loop_seconds((folder / "stdout.txt").read_text(errors="replace")) is not None
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


def refusal(case: Case) -> InputProblem | None:
    """Damped contacts that are pressed and moving at time 0: its velocities begin half a step before."""
    chain = case.chain
    closing = np.append(0.0, chain.velocity_m_s[:-1]) - chain.velocity_m_s
    moving = (chain.overlap_m > 0) & (closing != 0)
    if not chain.damping_ratio or not moving.any():
        return None
    found = f"bead {int(np.argmax(moving)) + 1} pressed and moving at time 0"
    return "chain.bead", found, "no such velocities, or contacts that are elastic"


ENGINE = Engine(
    how_to_get="Debian's packages yade and python3-yade",
    find=lambda: find_program("yade"),
    version=lambda executable: version_in_words(executable, "--version", r"Yade version: ([^\s,]+)"),
    scheme=IN_HEIGHTS,
    shear=INCREMENTAL,
    models=STRAIGHT | SIDEWAYS,
    refusal=refusal,
    render=render,
    server=Deck({"serve.py": render_template("yade/serve.py.j2")}, ("yade", "-n", "-x", "serve.py"), raw=()),
    read=read,
    failure_reason=lambda stdout, stderr: last_line(stdout, stderr, CHATTER),
    loop_pattern=r"^completed \d+ steps in ([0-9.]+) s$",
    on_two_cores=lambda deck: replace(deck, command=("yade", "-j2", *deck.command[1:])),
    precise_builds={"yade-longdouble": 10_000, "yade-float128": 1000},
    style=Style("#d55e00", dashes=(0, (4, 3)), marker="x", size=4.0),
)
