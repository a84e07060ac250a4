"""Traces of a case by the in-repo schemes (velocity Verlet with two kinds of rounding, exact motion); errors of a run.

Quantities are named like observables, without the unit: ``wall_peak``, ``bead_9_arrival``, ``speed_9_to_5``. Errors:

* ``force``: largest difference over all contacts and sample times, over the largest change of force;
* ``energy``: largest change over the largest kinetic energy; with damping the largest difference from the exact motion;
* peaks: relative to the true value minus the static load;
* all others: relative to the true value.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, arrays_of, moving_at_start, sphere_for_face, tube_arrays_of
from drivers.chain.trace import Trace, energy_error_J, make_trace, until
from drivers.limits.refusal import FORCE
from postproc.read.observables import describe, observe, scale_of, without_unit
from postproc.read.residual import largest_kinetic_J, residual, share_of_change
from validation.reference.adaptive import MIN_TOLERANCE, integrate_adaptive
from validation.reference.hertz_chain import Motion, TubeChain, TubeMotion
from validation.reference.tube import TOTAL, integrate_tube
from validation.reference.velocity_verlet import integrate_verlet, integrate_verlet_absolute

TURN_RAD = 1.0  # rotation about the axis, which changes rounding errors only
ENERGY = "energy"
SAMPLE_FACTOR = 4  # factor of samples for true peaks: quintic interpolation leaves 4^-6 of the sampling error
# tolerance of the second motions, over the tolerance of the first, whose error they measure
ROUGH_FACTOR, NEAR_FACTOR = 100.0, 3.0
LINEAR_SHARE = 1e-3  # of the largest change: larger differences do not shrink with the tolerance
COARSE_ERROR = 0.1  # larger tolerances are meaningless
MAX_FINE_VALUES = 4_000_000  # values of the finer record; beyond, the sampling error is not measured


def verlet_of(case: Case, law: str = TOTAL, finer: int = 1) -> Trace:
    """Integrate a case by velocity Verlet, the scheme of the codes: in overlaps, or in three dimensions.

    Args:
        case: the case.
        law: law of friction in three dimensions, as in ``shear`` of an engine.
        finer: divisor of the time step.
    """
    if case.chain.lateral is not None:
        return _trace_of_tube(case, _tube_motion(case, tube_arrays_of(case.chain), law, finer))
    scene = case.scene
    timing = scene.time_step_s / finer, finer * scene.steps_per_sample, scene.samples
    motion = integrate_verlet(arrays_of(case.chain), *timing)
    return trace_of(case, case.sample_times_s, motion)


def verlet_in_heights(case: Case) -> Trace:
    """Integrate a case by velocity Verlet with absolute heights as its state, as the codes do.

    The only difference from ``verlet_of`` is the rounding of positions, a few 1e-18 m a step, which accumulates for
    slow beads and grows exponentially in a chaotic chain.
    """
    scene = case.scene
    height, reach = heights_and_reach(case)
    timing = (scene.time_step_s, scene.steps_per_sample, scene.samples)
    motion = integrate_verlet_absolute(arrays_of(case.chain), height, reach, *timing)
    return trace_of(case, case.sample_times_s, motion)


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
    return _trace_of_tube(case, replace(motion, place_m=(motion.place_m - lift) @ turn.T, **turned))


def heights_and_reach(case: Case) -> tuple[Array, Array]:
    """Heights at time 0 and distances at which neighbours (body 1 and height 0) just touch, in m. Shape (bodies,).

    A damped flat face is replaced by a large sphere, as in LIGGGHTS.
    """
    chain = case.chain
    flat = np.isinf(chain.radius_m)
    face = sphere_for_face(case.scene, chain)[0] if flat.any() and chain.damping_ratio else 0.0
    radius = np.where(flat, face, chain.radius_m)
    reach = radius + np.concatenate([[chain.wall_height_m], radius[:-1]])
    return np.asarray(chain.height_m + np.where(flat, face, 0.0)), np.asarray(reach)


def trace_of(case: Case, time_s: Array, motion: Motion) -> Trace:
    """Trace of an in-repo motion."""
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


@dataclass(frozen=True)
class ExactMotion:
    """Exact motion of a case.

    Attributes:
        trace: at the sample times of the case.
        fine: with four times as many samples; the same object as ``trace`` if that is too many.
        tolerance: tolerance of the integration.
    """

    case: Case
    trace: Trace
    fine: Trace
    tolerance: float

    @cached_property
    def true(self) -> dict[str, float]:
        """Values of the observed quantities, from the finer record."""
        return quantities(self.case, self.fine)

    @cached_property
    def sampled(self) -> dict[str, float]:
        """Values of the observed quantities, from the samples of the case."""
        return quantities(self.case, self.trace)

    @property
    def sampling_known(self) -> bool:
        """True if ``fine`` has more samples than ``trace``."""
        return self.fine is not self.trace

    @cached_property
    def error_N(self) -> Array:
        """Largest force error of the exact motion until each sample, in N; see ``own_error_N``. Shape (samples,)."""
        return own_error_N(self.case, self.trace, self.tolerance)

    def first(self, samples: int) -> "ExactMotion":
        """The first samples of the motion."""
        factor = (len(self.fine.time_s) - 1) // max(len(self.trace.time_s) - 1, 1)
        trace = until(self.trace, samples)
        return replace(self, trace=trace, fine=until(self.fine, factor * (samples - 1) + 1) if factor > 1 else trace)


def exact_motion_of(case: Case, tolerance: float = MIN_TOLERANCE, *, finer: bool = True) -> ExactMotion:
    """Exact motion of a case, with a force error of at most ``tolerance`` times the largest change.

    Raises:
        ArithmeticError: the integrator fails.
    """
    factor = SAMPLE_FACTOR if finer and SAMPLE_FACTOR * case.scene.samples * case.chain.bodies <= MAX_FINE_VALUES else 1
    spacing = case.scene.steps_per_sample * case.scene.time_step_s / factor
    time = np.arange(factor * (case.scene.samples - 1) + 1, dtype=float) * spacing
    motion = integrate_adaptive(arrays_of(case.chain), time, tolerance)
    fine = trace_of(case, time, motion)
    if factor == 1:
        return ExactMotion(case, fine, fine, tolerance)
    kept = Motion(*(values[::factor] for values in (motion.force_N, motion.displacement_m, motion.velocity_m_s)))
    return ExactMotion(case, trace_of(case, case.sample_times_s, kept), fine, tolerance)


def own_error_N(case: Case, exact: Trace, tolerance: float = MIN_TOLERANCE) -> Array:
    """Measured force error of an exact motion, largest until each sample, in N. Shape (samples,).

    While differences are small enough to grow linearly: the difference from a motion with ``ROUGH_FACTOR`` times the
    tolerance, divided by that factor. Beyond, in a chaotic motion: the difference from a motion with ``NEAR_FACTOR``
    times the tolerance. On 27 random scenes with light beads and flat strikers and on a chaotic one of 121 bodies the
    estimate is 1/12 to 30 times the true error, mostly 1/2 to 3 times.

    Raises:
        ArithmeticError: the integrator fails.
    """

    def apart(factor: float) -> Array:
        other = exact_motion_of(case, min(factor * tolerance, COARSE_ERROR), finer=False).trace
        return np.asarray(np.maximum.accumulate(np.abs(other.force_N - exact.force_N).max(axis=1)))

    rough = apart(ROUGH_FACTOR)
    linear = share_of_change(rough, exact) < LINEAR_SHARE
    return np.maximum.accumulate(np.where(linear, rough / ROUGH_FACTOR, 0.0 if linear.all() else apart(NEAR_FACTOR)))


def quantities(case: Case, trace: Trace) -> dict[str, float]:
    """Observables of the pulses in a trace, by name without the unit."""
    values = observe(case.layout, trace).items()
    return {without_unit(name): value for name, value in values if describe(name).of_wave and np.isfinite(value)}


def errors_of(case: Case, trace: Trace, truth: ExactMotion, names: Collection[str]) -> dict[str, float]:
    """Errors of the named quantities; inf for a quantity missing in the trace.

    Raises:
        KeyError: a quantity is missing in the exact motion.
    """
    errors = {}
    seen = {} if {*names} <= {FORCE, ENERGY} else quantities(case, trace)
    for name in names:
        if name == FORCE:
            errors[name] = float(residual(trace, truth.trace).max())
        elif name == ENERGY:
            errors[name] = float(energy_change_J(case.chain, trace, truth.trace).max())
            errors[name] /= largest_kinetic_J(case.chain, truth.trace)
        else:
            errors[name] = abs(seen.get(name, np.inf) - truth.true[name]) / scale_of(name, truth.true)
    return {name: error if np.isfinite(error) else np.inf for name, error in errors.items()}


def energy_change_J(chain: Chain, trace: Trace, exact: Trace | None) -> Array:
    """Error of the energy at each sample, in J; with damping, the difference from the exact motion if it is known."""
    if chain.damped and exact is not None:
        return np.asarray(np.abs(trace.total_energy_J - exact.total_energy_J))
    return energy_error_J(trace.total_energy_J, damped=chain.damped, slips=chain.slips)


def momentum_error(case: Case, trace: Trace, truth: ExactMotion) -> float:
    """Largest difference of momentum over the largest momentum."""
    scale = max(float(np.abs(truth.trace.momentum_N_s).max()), moving_at_start(case.chain)) or 1.0
    return float(np.abs(trace.momentum_N_s - truth.trace.momentum_N_s).max()) / scale
