"""YADE in three dimensions: renders ``templates/yade/tube.py.j2``, reads its arrays."""

from dataclasses import dataclass
from math import atan
from pathlib import Path

import numpy as np

from drivers.base.decks import render as render_template
from drivers.chain.case import Case
from drivers.chain.trace import Sideways, Trace, make_sideways_trace
from drivers.engines._arrays import load_arrays
from drivers.engines._sums import contact_forces, towards_axis
from drivers.engines._yade_values import common_values, staggered_velocities

# by default friction's arm is not the same for slip and for torque
SPHERES = "Ig2_Sphere_Sphere_ScGeom(avoidGranularRatcheting=False)"
WALLS = "Ig2_Wall_Sphere_ScGeom(hertzian=True, noRatch=False)"
FACETS = "Ig2_Facet_Sphere_ScGeom(hertzian=True)"


@dataclass(frozen=True)
class Body:
    """A bead, a striker, or its face; lengths in m, velocities in m/s."""

    x: float
    y: float
    height: float
    radius: float
    mass: float
    x_velocity: float
    y_velocity: float
    velocity: float
    material: str


def render(case: Case) -> str:
    """``chain.py``."""
    chain, lateral = case.chain, case.chain.lateral
    assert lateral is not None
    staggered = staggered_velocities(case)
    bodies = [
        Body(
            x=lateral.offset_m[i, 0],
            y=lateral.offset_m[i, 1],
            height=chain.height_m[i],
            radius=chain.radius_m[i],
            mass=chain.mass_kg[i],
            x_velocity=lateral.velocity_m_s[i, 0],
            y_velocity=lateral.velocity_m_s[i, 1],
            velocity=staggered[i],
            material=chain.materials[i],
        )
        for i in range(chain.bodies)
    ]
    flat = bodies.pop() if np.isinf(chain.radius_m[-1]) else None
    bore = lateral.bore
    geometries = [SPHERES] if len(bodies) > 1 else []
    if chain.wall or flat:
        geometries.append(WALLS)
    if bore:
        geometries.append(FACETS)
    guided = bore.guided if bore else []
    return render_template(
        "yade/tube.py.j2",
        **common_values(case),
        friction_angle=atan(lateral.friction),
        slips=lateral.slips,
        rotation=lateral.turns,
        spheres=bodies,
        flat=flat,
        geometries=geometries,
        guided=guided,
        sides=bore.sides if bore else None,
        low=bore.low_m if bore else 0.0,
        length=bore.high_m - bore.low_m if bore else 0.0,
        bore_radius=bore.radius_m if bore else 0.0,
        bore_stiffness=[float(bore.stiffness[i]) for i in guided] if bore else [],
        bore_shear=[float(bore.shear_stiffness[i]) for i in guided] if bore else [],
        bore_friction=bore.friction if bore else 0.0,
    )


def read(case: Case, folder: Path) -> Trace:
    """The arrays as a trace, brought to the time of the forces; contact forces follow by summing from the wall up.

    Raises:
        RunError: the file, an array or part of it is missing.
    """
    chain, samples, step = case.chain, case.scene.samples, case.scene.time_step_s
    assert chain.lateral is not None
    bore = chain.lateral.bore
    shape = (samples, chain.bodies, 3)
    shapes: dict[str, tuple[int, ...]] = {"force": shape, "place": shape, "velocity": shape}
    if chain.lateral.turns:
        shapes["spin"] = shapes["torque"] = shape
    if chain.wall:
        shapes["on_wall"] = (samples, 3)
    if bore:
        shapes["on_bore"] = (samples, len(bore.guided), 3)
    arrays = load_arrays(folder / "chain.npz", shapes)
    by_bore = np.zeros(shape)
    if bore:
        by_bore[:, bore.guided] = arrays["on_bore"]
    total = arrays["force"].copy()  # all but gravity's
    total[:, :, 2] -= chain.gravity_m_s2 * chain.mass_kg
    velocity = arrays["velocity"] - 0.5 * step * total / chain.mass_kg[:, np.newaxis]
    place = arrays["place"] - step * arrays["velocity"]
    flat = np.isinf(chain.radius_m)
    velocity[:, flat, :2], place[:, flat, :2] = 0.0, 0.0  # guided
    from_wall = -arrays["on_wall"][:, 2] if chain.wall else np.zeros(samples)
    contacts = total[:, :, 2] - chain.load_N - by_bore[:, :, 2]
    force = contact_forces(from_wall, contacts)
    spin = np.zeros(shape)
    if "spin" in arrays:
        inertia = 0.4 * chain.mass_kg * chain.radius_m**2  # inf of a flat face
        spin = arrays["spin"] - 0.5 * step * arrays["torque"] / inertia[:, np.newaxis]
    sideways = Sideways(place[:, :, :2], velocity[:, :, :2], spin, towards_axis(place[:, :, :2], by_bore[:, :, :2]))
    friction = by_bore[:, :, 2].sum(axis=1) if bore else None
    return make_sideways_trace(chain, case.sample_times_s, force, place[:, :, 2], velocity[:, :, 2], friction, sideways)
