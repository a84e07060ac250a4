"""A case by the in-repo schemes, as traces: velocity Verlet at the case's step, and the same rounded otherwise."""

from dataclasses import replace

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array, arrays_of, sphere_for_face, tube_arrays_of
from drivers.chain.trace import Trace, make_trace
from validation.reference.hertz_chain import Motion, TubeChain, TubeMotion
from validation.reference.tube import TOTAL, integrate_tube
from validation.reference.velocity_verlet import integrate_verlet, integrate_verlet_absolute

TURN_RAD = 1.0  # about the axis, for the run that only rounds otherwise


def verlet_of(case: Case, law: str = TOTAL, finer: int = 1) -> Trace:
    """The case by the scheme of the codes: in overlaps, or in three dimensions.

    Args:
        case: what to run.
        law: of friction in three dimensions: what it keeps, as ``shear`` of an engine.
        finer: by what to divide the time step there.
    """
    if case.chain.lateral is not None:
        return _trace_of_tube(case, _tube_motion(case, tube_arrays_of(case.chain), law, finer))
    scene = case.scene
    motion = integrate_verlet(arrays_of(case.chain), scene.time_step_s, scene.steps_per_sample, scene.samples)
    return trace_of(case, case.sample_times_s, motion)


def verlet_in_heights(case: Case) -> Trace:
    """The same scheme rounded otherwise: with absolute heights as its state, as engines hold them.

    It does the same arithmetic as ``verlet_of`` but for the rounding of places: a few 1e-18 m a step, which slow beads
    gather and a chaotic chain multiplies.
    """
    scene = case.scene
    height, reach = heights_and_reach(case)
    timing = (scene.time_step_s, scene.steps_per_sample, scene.samples)
    motion = integrate_verlet_absolute(arrays_of(case.chain), height, reach, *timing)
    return trace_of(case, case.sample_times_s, motion)


def turned_verlet_of(case: Case, law: str) -> Trace:
    """The same of three dimensions: computed turned about the axis and twice as high."""
    chain = tube_arrays_of(case.chain)
    lift = np.array([0, 0, float(np.abs(chain.place_m[:, 2]).max())])
    turn = np.array([[np.cos(TURN_RAD), np.sin(TURN_RAD), 0], [-np.sin(TURN_RAD), np.cos(TURN_RAD), 0], [0, 0, 1]])
    moved = replace(
        chain,
        place_m=chain.place_m @ turn + lift,
        velocity_m_s=chain.velocity_m_s @ turn,
        wall_m=chain.wall_m + lift[2],
    )
    motion = _tube_motion(case, moved, law)
    turned = {name: getattr(motion, name) @ turn.T for name in ("bore_N", "velocity_m_s", "spin_rad_s")}
    return _trace_of_tube(case, replace(motion, place_m=(motion.place_m - lift) @ turn.T, **turned))


def heights_and_reach(case: Case) -> tuple[Array, Array]:
    """Heights at time 0, and the distances at which neighbours (body 1 and the height 0) just touch. Shape (bodies,).

    A damped flat face is the large sphere that LIGGGHTS has to take it for.
    """
    chain = case.chain
    flat = np.isinf(chain.radius_m)
    face = sphere_for_face(case.scene, chain)[0] if flat.any() and chain.damping_ratio else 0.0
    radius = np.where(flat, face, chain.radius_m)
    reach = radius + np.concatenate([[chain.wall_height_m], radius[:-1]])
    return np.asarray(chain.height_m + np.where(flat, face, 0.0)), np.asarray(reach)


def trace_of(case: Case, time_s: Array, motion: Motion) -> Trace:
    """An in-repo motion as a trace."""
    height = case.chain.height_m + motion.displacement_m
    return make_trace(case.chain, time_s, motion.force_N, height, motion.velocity_m_s)


def _tube_motion(case: Case, chain: TubeChain, law: str, finer: int = 1) -> TubeMotion:
    scene = case.scene
    with np.errstate(all="ignore"):  # too large a step blows up
        return integrate_tube(chain, scene.time_step_s / finer, finer * scene.steps_per_sample, scene.samples, law)


def _trace_of_tube(case: Case, motion: TubeMotion) -> Trace:
    force, place, velocity = motion.force_N, motion.place_m, motion.velocity_m_s
    times, spin, bore = case.sample_times_s, motion.spin_rad_s, motion.bore_N
    return make_trace(case.chain, times, force, place, velocity, spin, bore)
