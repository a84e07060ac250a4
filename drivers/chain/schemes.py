"""Traces of a case by the integrators of this repository: velocity Verlet with two kinds of rounding, exact motion.

Every part of the project that needs such a motion in memory takes it from here.
"""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from contextvars import copy_context
from dataclasses import replace
from functools import partial
from math import inf
from typing import TypeVar

import numpy as np

from drivers.base.processes import waited
from drivers.chain.case import Case
from drivers.chain.chain import Array, arrays_of, sphere_for_face, tube_arrays_of
from drivers.chain.trace import Trace, make_trace, with_work
from validation.reference.adaptive import MIN_TOLERANCE, integrate_adaptive, scales
from validation.reference.hertz_chain import Flag, HertzChain, Motion, TubeChain, TubeMotion
from validation.reference.tube import TOTAL, integrate_tube
from validation.reference.velocity_verlet import integrate_verlet, integrate_verlet_absolute

TURN_RAD = 1.0  # rotation about the axis, which changes rounding errors only
MIN_LIMIT_S = 60.0
SECONDS_PER_BODY_AND_STEP = 5e-6  # ten times the cost of the slowest engine
SHORT = 1_000_000  # bodies times steps: some hundredths of a second; of three dimensions and exact motions some tenths

Result = TypeVar("Result")
_threads = ThreadPoolExecutor(256)  # kept, since the start of a thread takes as long as a small chain


def default_limit_s(case: Case) -> float:
    """Time limit of a run and of an exact motion, in proportion to bodies times steps."""
    return MIN_LIMIT_S + SECONDS_PER_BODY_AND_STEP * case.work


def endable(integrate: Callable[[Flag], Result], limit_s: float = inf, work: float = inf) -> Result:
    """Result of a compiled integration in a thread, which a signal or the time limit ends by its flag.

    Compilation, which happens once, does not count. An integration that is ``SHORT`` by its ``work``, bodies times
    steps, runs in this thread.

    Raises:
        TimeoutError: it took longer than the time limit.
    """
    from validation.reference.contact_kernels import compiled_s  # numba takes long to load

    stop: Flag = np.zeros(1, bool)
    began_s = time.perf_counter() - compiled_s()

    def until_s() -> float:
        return began_s + limit_s + compiled_s()

    if work <= SHORT:
        result = integrate(stop)
        if time.perf_counter() <= until_s():
            return result
        raise TimeoutError
    integration = _threads.submit(copy_context().run, integrate, stop)  # with its treatment of overflows
    in_time = False
    try:
        while not in_time and time.perf_counter() < until_s():
            in_time = waited(lambda seconds: wait([integration], seconds).done, until_s())
    finally:
        stop[0] = True
        wait([integration])
    if in_time:
        return integration.result()
    raise TimeoutError


def work_of_exact(chain: HertzChain, duration_s: float) -> float:
    """Bodies times steps of an exact motion, about: bodies times the times in which the scale of overlap is passed.

    It is not known, inf, for a driven chain: its drive may be as fast as it likes.
    """
    overlap_m, speed_m_s = scales(chain, duration_s)
    return chain.mass_kg.size**2 * duration_s * speed_m_s / overlap_m if chain.drive is None else inf


def exact_motion(
    case: Case, tolerance: float, time_s: Array, *, limit_s: float | None = None, energies: bool = False
) -> Motion:
    """Exact motion of a straight chain at any times.

    Args:
        case: the case.
        tolerance: largest force error, relative to the largest force.
        time_s: times in s, from 0 on.
        limit_s: time limit; None for ``default_limit_s``.
        energies: True to integrate the energies of contacts and bodies as well.

    Raises:
        ArithmeticError: the integrator fails, or takes longer than the limit.
    """
    limit_s, chain = limit_s or default_limit_s(case), arrays_of(case.chain)
    integrate = partial(integrate_adaptive, chain, time_s, tolerance, energies=energies)
    try:
        return endable(lambda stop: integrate(stop=stop), limit_s, work_of_exact(chain, float(time_s[-1])))
    except TimeoutError:
        raise ArithmeticError(f"the exact motion takes longer than {limit_s:g} s") from None


def exact_of(case: Case, tolerance: float = MIN_TOLERANCE, finer: int = 1, limit_s: float | None = None) -> Trace:
    """``exact_motion`` as a trace at the samples of the case, or at ``finer`` times as many."""
    spacing = case.scene.steps_per_sample * case.scene.time_step_s / finer
    times = np.arange(finer * (case.scene.samples - 1) + 1, dtype=float) * spacing
    return trace_of(case, times, exact_motion(case, tolerance, times, limit_s=limit_s))


def verlet_motion(case: Case, finer: int = 1, *, energies: bool = False) -> Motion:
    """Motion of a straight chain by velocity Verlet in overlaps, at the step of the case divided by ``finer``."""
    timing = case.scene.time_step_s / finer, finer * case.scene.steps_per_sample, case.scene.samples
    integrate = partial(integrate_verlet, arrays_of(case.chain), *timing, energies=energies)
    return endable(lambda stop: integrate(stop=stop), work=finer * case.work)


def verlet_of(case: Case, law: str = TOTAL, finer: int = 1) -> Trace:
    """Integrate a case by velocity Verlet, the scheme of the codes: in overlaps, or in three dimensions.

    Args:
        case: the case.
        law: law of friction in three dimensions, as in ``shear`` of an engine.
        finer: divisor of the time step.
    """
    straight = case.chain.straight
    motion = verlet_motion(case, finer) if straight else _tube_motion(case, tube_arrays_of(case.chain), law, finer)
    return trace_of(case, case.sample_times_s, motion)


def verlet_in_heights(case: Case) -> Trace:
    """Integrate a case by velocity Verlet with absolute heights as its state, as the codes do.

    The only difference from ``verlet_of`` is the rounding of positions, a few 1e-18 m a step, which accumulates for
    slow beads and grows exponentially in a chaotic chain. The work of a drive is not summed.
    """
    scene, (height, reach) = case.scene, heights_and_reach(case)
    timing = scene.time_step_s, scene.steps_per_sample, scene.samples
    integrate = partial(integrate_verlet_absolute, arrays_of(case.chain), height, reach, *timing)
    return trace_of(case, case.sample_times_s, endable(integrate, work=case.work))


def turned_verlet_of(case: Case, law: str) -> Trace:
    """Integrate a three-dimensional case turned about the axis and lifted, which changes rounding errors only."""
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
    return trace_of(case, case.sample_times_s, replace(motion, place_m=(motion.place_m - lift) @ turn.T, **turned))


def printed_of(case: Case, trace: Trace) -> Trace:
    """Trace of a straight chain by heights and velocities with the digits of the case.

    Forces are off by a tenth of a unit of the last digit of the largest, and so judged to a unit: sums of printed
    forces on bodies were off by up to 0.3 units.
    """
    printed = np.vectorize(lambda value: float(f"{value:.{case.digits}g}"))
    off_N = 10.0**-case.digits * np.abs(trace.force_N).max(axis=1, keepdims=True)
    place, velocity = printed(trace.height_m), printed(trace.velocity_m_s)
    return with_work(make_trace(case.chain, trace.time_s, trace.force_N + off_N, place, velocity), trace)


def heights_and_reach(case: Case) -> tuple[Array, Array]:
    """Heights at time 0 and distances at which neighbours (body 1 and height 0) just touch, in m. Shape (bodies,).

    A damped flat face is replaced by a large sphere, as in LIGGGHTS.
    """
    chain = case.chain
    flat = np.isinf(chain.radius_m)
    face = sphere_for_face(case.scene, chain)[0] if flat.any() and chain.damped and not chain.law.alpha else 0.0
    radius = np.where(flat, face, chain.radius_m)
    reach = radius + np.concatenate([[chain.wall_height_m], radius[:-1]])
    return np.asarray(chain.height_m + np.where(flat, face, 0.0)), np.asarray(reach)


def trace_of(case: Case, time_s: Array, motion: Motion | TubeMotion) -> Trace:
    """Trace of an in-repo motion."""
    chain, force, velocity = case.chain, motion.force_N, motion.velocity_m_s
    if isinstance(motion, TubeMotion):
        return make_trace(chain, time_s, force, motion.place_m, velocity, motion.spin_rad_s, motion.bore_N)
    moved = motion.displacement_m
    trace = make_trace(chain, time_s, force, chain.height_m + moved, velocity, displacement_m=moved)
    return with_work(trace, motion)


def _tube_motion(case: Case, chain: TubeChain, law: str, finer: int = 1) -> TubeMotion:
    scene = case.scene
    timing = scene.time_step_s / finer, finer * scene.steps_per_sample, scene.samples
    with np.errstate(all="ignore"):  # too large a step blows up
        return endable(partial(integrate_tube, chain, *timing, law), work=finer * case.work)
