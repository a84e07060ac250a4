"""The scheme of the codes with what can be wrong with it, independent of the engine ``verlet``.

A leapfrog in absolute heights or in overlaps:
``v(t + dt/2) = v(t - dt/2) + a(t) dt; z(t + dt) = z(t) + v(t + dt/2) dt``.
"""

from dataclasses import dataclass
from functools import cached_property
from math import sqrt

import numpy as np
from numba import njit

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.engines import EXACT, IN_HEIGHTS, load_engine
from validation.accuracy.schemes import heights_and_reach
from validation.reference.adaptive import integrate_adaptive
from validation.reference.hertz_chain import HertzChain

TOLERANCE = 1e-11  # of the adaptive integrator, for the engine that is exact


@dataclass(frozen=True)
class Model:
    """A chain and how it is integrated; arrays of shape (bodies,), SI units, as in ``drivers.chain.chain``.

    Attributes:
        placed_m: heights that belong to ``resting_m``; a face's may be that of a sphere.
        reach_m: distance of neighbouring bodies that just touch.
        resting_m: overlaps of the scene at time 0; what ``overlap_m`` differs from them moves bodies.
        damping_ratio: B of each contact (``drivers.chain.contact_law``).
        assumed_m_s2: accelerations of the scene at time 0, with which a code may set velocities half a step back.
        scene_load_N: loads of the scene, with which an adapter may sum forces: see ``readings``.
        attracts: whether damped contacts may pull.
        local_damping: d of Cundall's non-viscous damping, ``a (1 - d sign(a v))`` with v at the time of a.
        ahead: by how many time steps the start velocities are ahead of those of the scene.
        staggered: whether the velocities half a step before time 0 are set with the scene's accelerations.
    """

    mass_kg: Array
    stiffness: Array
    overlap_m: Array
    velocity_m_s: Array
    load_N: Array
    damping_ratio: Array
    placed_m: Array
    reach_m: Array
    resting_m: Array
    assumed_m_s2: Array
    scene_load_N: Array
    scheme: str
    time_step_s: float
    steps_per_sample: int
    attracts: bool = False
    local_damping: float = 0.0
    ahead: float = 0.0
    staggered: bool = False

    @cached_property
    def height_m(self) -> Array:
        """Heights at time 0. Shape (bodies,)."""
        return np.asarray(self.placed_m - np.cumsum(self.overlap_m - self.resting_m))

    @cached_property
    def damping(self) -> Array:
        """C of each contact in ``C d^(1/4) d'``. Shape (bodies,)."""
        inverse = 1 / self.mass_kg
        reduced = 1 / (inverse + np.append(0.0, inverse[:-1]))
        return np.asarray(2 * self.damping_ratio * np.sqrt(1.5 * self.stiffness * reduced))

    @property
    def bodies(self) -> int:
        """How many."""
        return self.mass_kg.size


@dataclass(frozen=True)
class Motion:
    """Samples of a motion; arrays of shape (samples, bodies).

    Attributes:
        velocity_m_s: at the time of the forces.
        later_m_s: half a step later.
        rise_m: since the scene's time 0.
    """

    force_N: Array
    velocity_m_s: Array
    later_m_s: Array
    rise_m: Array


def model_of(case: Case, engine: str) -> Model:
    """The scene as it should be on an engine."""
    chain, scene = case.chain, case.scene
    height, reach = heights_and_reach(case)
    return Model(
        mass_kg=chain.mass_kg, stiffness=chain.stiffness, overlap_m=chain.overlap_m, velocity_m_s=chain.velocity_m_s,
        load_N=chain.load_N, damping_ratio=np.full(chain.bodies, chain.damping_ratio), placed_m=height, reach_m=reach,
        resting_m=chain.overlap_m, assumed_m_s2=chain.acceleration_m_s2, scene_load_N=chain.load_N,
        scheme=load_engine(engine).scheme, time_step_s=scene.time_step_s, steps_per_sample=scene.steps_per_sample,
    )  # fmt: skip


def moved(model: Model, samples: int) -> Motion:
    """The motion of a model, a sample every ``steps_per_sample`` steps from time 0 on."""
    if model.scheme == EXACT:
        return _exactly_moved(model, samples)
    start = model.assumed_m_s2 if model.staggered else _acceleration(model)
    before = model.velocity_m_s + (model.ahead - 0.5) * model.time_step_s * start
    moves = _integrate(
        model.mass_kg, model.stiffness, model.damping, model.load_N, model.reach_m, model.height_m.copy(),
        model.overlap_m.copy(), model.velocity_m_s, before, model.scheme == IN_HEIGHTS, model.attracts,
        model.local_damping, model.time_step_s, model.steps_per_sample, samples,
    )  # fmt: skip
    return Motion(*moves)


def _exactly_moved(model: Model, samples: int) -> Motion:
    chain = HertzChain(model.mass_kg, model.stiffness, model.overlap_m, model.velocity_m_s, model.load_N, model.damping)
    times = np.arange(samples, dtype=float) * (model.time_step_s * model.steps_per_sample)
    motion = integrate_adaptive(chain, times, TOLERANCE)
    return Motion(motion.force_N, motion.velocity_m_s, motion.velocity_m_s, motion.displacement_m)


def _acceleration(model: Model) -> Array:
    closed = np.maximum(model.overlap_m, 0.0)
    closing = np.append(0.0, model.velocity_m_s[:-1]) - model.velocity_m_s
    force = model.stiffness * closed**1.5 + model.damping * closed**0.25 * closing
    if not model.attracts:
        force = np.maximum(force, 0.0)
    net = force - np.append(force[1:], 0.0) + model.load_N
    rounded = np.abs(net) <= 1e-12 * (force + np.append(force[1:], 0.0) + np.abs(model.load_N))
    acceleration = np.where(rounded, 0.0, net) / model.mass_kg
    return np.asarray(acceleration * (1 - model.local_damping * np.sign(acceleration * model.velocity_m_s)))


def readings(model: Model, force_N: Array) -> list[Array]:
    """Contact forces as adapters read them: each, or summed from the lowest up, ``F_{j+1} = F_j - (f_j - load_j)``.

    The latter, with f the total forces on bodies, goes wrong where loads are not those of the scene.
    """
    if np.array_equal(model.load_N, model.scene_load_N):
        return [force_N]
    excess = np.cumsum(model.load_N - model.scene_load_N)
    return [force_N, np.asarray(force_N - np.append(0.0, excess[:-1]))]


@njit(cache=True, nogil=True, error_model="numpy")
def _integrate(
    mass: Array, stiffness: Array, damping: Array, load: Array, reach: Array, height: Array, overlap: Array,
    velocity0: Array, before: Array, absolute: bool, attracts: bool, local: float, dt: float, every: int, samples: int,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    n = mass.size
    velocity, force, start = before.copy(), np.zeros(n + 1), height.copy()
    forces, now, later, rise = (
        np.empty((samples, n)), np.empty((samples, n)), np.empty((samples, n)), np.empty((samples, n))
    )  # fmt: skip
    kick, damped = dt / mass, damping.any()
    for step in range((samples - 1) * every + 1):
        below = 0.0
        if absolute:
            for j in range(n):
                overlap[j] = reach[j] - (height[j] - below)
                below = height[j]
        for j in range(n):
            closed = max(overlap[j], 0.0)
            force[j] = stiffness[j] * closed * sqrt(closed)
        if damped:
            _damp(force, overlap, damping, velocity if step else velocity0, attracts)
        if step % every == 0:
            row = step // every
            for j in range(n):
                change = _change(kick[j], force[j], force[j + 1], load[j], velocity[j], local)
                forces[row, j] = force[j]
                now[row, j] = velocity[j] + 0.5 * kick[j] * (force[j] - force[j + 1] + load[j])
                later[row, j] = velocity[j] + change
                rise[row, j] = height[j] - start[j]
        below = 0.0
        for j in range(n):
            if local == 0.0:
                here = velocity[j] + kick[j] * (force[j] - force[j + 1] + load[j])
            else:
                here = velocity[j] + _change(kick[j], force[j], force[j + 1], load[j], velocity[j], local)
            velocity[j] = here
            height[j] += dt * here
            if not absolute:
                overlap[j] += dt * (below - here)
                below = here
    return forces, now, later, rise


@njit(cache=True, nogil=True, error_model="numpy")
def _change(kick: float, under: float, above: float, load: float, velocity: float, local: float) -> float:
    """What a step adds to a velocity; the sign of non-viscous damping is of the velocity at the time of the forces."""
    change = kick * (under - above + load)
    damped: float = change * (1.0 - local * np.sign(change * (velocity + 0.5 * change)))
    return damped


@njit(cache=True, nogil=True, error_model="numpy")
def _damp(force: Array, overlap: Array, damping: Array, velocity: Array, attracts: bool) -> None:
    """Adds what closed contacts lose energy by."""
    for j in range(overlap.size):
        if overlap[j] > 0.0 and damping[j] > 0.0:
            closing = (velocity[j - 1] if j > 0 else 0.0) - velocity[j]
            force[j] += damping[j] * sqrt(sqrt(overlap[j])) * closing
            if not attracts and force[j] < 0.0:
                force[j] = 0.0
