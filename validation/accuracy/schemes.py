"""A case by the in-repo schemes, as traces: rounded in two ways, or exact; and errors of a run, by quantity.

Quantities are named like observables, without the unit: ``wall_peak``, ``bead_9_arrival``, ``speed_9_to_5``. The error
of ``force`` is the largest difference of all contacts and sample times over the largest change of force, that of
``energy`` the largest change over the largest kinetic energy (where contacts lose energy, the largest difference); that
of a peak is relative to its true value less the static load, all others to the true value.
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
from validation.reference.adaptive import LEAST_TOLERANCE, integrate_adaptive
from validation.reference.hertz_chain import Motion, TubeChain, TubeMotion
from validation.reference.tube import TOTAL, integrate_tube
from validation.reference.velocity_verlet import integrate_verlet, integrate_verlet_absolute

TURN_RAD = 1.0  # about the axis, for the run that only rounds otherwise
ENERGY = "energy"
FINER = 4  # times the samples that true peaks are read from: quintics leave 4^-6 of the error of sampling
# times the tolerance: that of second motions, by which the first one's error is measured
ROUGH_FACTOR, NEAR_FACTOR = 100.0, 3.0
LINEAR_SHARE = 1e-3  # of the largest change: larger differences no longer shrink with the tolerance
COARSE_ERROR = 0.1  # tolerances beyond it tell nothing
MAX_FINE_VALUES = 4_000_000  # values of the finer record; beyond it the error of sampling is not measured


def verlet_of(case: Case, law: str = TOTAL, finer: int = 1) -> Trace:
    """The case by the scheme of the codes: in overlaps, or in three dimensions.

    Args:
        case: what to run.
        law: of friction in three dimensions: what it keeps, as ``shear`` of an engine.
        finer: by what to divide the time step.
    """
    if case.chain.lateral is not None:
        return _trace_of_tube(case, _tube_motion(case, tube_arrays_of(case.chain), law, finer))
    scene = case.scene
    timing = scene.time_step_s / finer, finer * scene.steps_per_sample, scene.samples
    motion = integrate_verlet(arrays_of(case.chain), *timing)
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


@dataclass(frozen=True)
class Truth:
    """A case's exact motion.

    Attributes:
        trace: at the case's sample times.
        fine: four times as fine; the same as ``trace`` where that would be too much.
        tolerance: with which it was followed.
    """

    case: Case
    trace: Trace
    fine: Trace
    tolerance: float

    @cached_property
    def true(self) -> dict[str, float]:
        """Quantities as the finer record has them; what is not seen is not in it."""
        return quantities(self.case, self.fine)

    @cached_property
    def sampled(self) -> dict[str, float]:
        """The same, read from the case's samples."""
        return quantities(self.case, self.trace)

    @property
    def sampling_known(self) -> bool:
        """Whether the finer record is one."""
        return self.fine is not self.trace

    @cached_property
    def known_N(self) -> Array:
        """Largest force error of the exact motion until each sample, as ``own_error_N`` measures it."""
        return own_error_N(self.case, self.trace, self.tolerance)

    def first(self, samples: int) -> "Truth":
        """The first samples of the motion."""
        factor = (len(self.fine.time_s) - 1) // max(len(self.trace.time_s) - 1, 1)
        trace = until(self.trace, samples)
        return replace(self, trace=trace, fine=until(self.fine, factor * (samples - 1) + 1) if factor > 1 else trace)


def truth_of(case: Case, tolerance: float = LEAST_TOLERANCE, *, finer: bool = True) -> Truth:
    """The exact motion of a case, good to ``tolerance`` of the largest change.

    Raises:
        ArithmeticError: it cannot be followed.
    """
    factor = FINER if finer and FINER * case.scene.samples * case.chain.bodies <= MAX_FINE_VALUES else 1
    spacing = case.scene.steps_per_sample * case.scene.time_step_s / factor
    time = np.arange(factor * (case.scene.samples - 1) + 1, dtype=float) * spacing
    motion = integrate_adaptive(arrays_of(case.chain), time, tolerance)
    fine = trace_of(case, time, motion)
    if factor == 1:
        return Truth(case, fine, fine, tolerance)
    kept = Motion(*(values[::factor] for values in (motion.force_N, motion.displacement_m, motion.velocity_m_s)))
    return Truth(case, trace_of(case, case.sample_times_s, kept), fine, tolerance)


def own_error_N(case: Case, exact: Trace, tolerance: float = LEAST_TOLERANCE) -> Array:
    """Largest force error until each sample of a motion that was followed with a tolerance. Shape (samples,).

    Measured: the difference from a motion with ``ROUGH_FACTOR`` times the tolerance, over that factor, as long as
    differences are small enough to grow linearly; beyond, where the motion is chaotic, the difference itself from a
    motion with ``NEAR_FACTOR`` times the tolerance. On 27 random scenes with light beads and flat strikers, and
    on a chaotic one of 121 bodies, it is from 1/12 to 30 times the true error; mostly half of it to three times.

    Raises:
        ArithmeticError: the motion cannot be followed.
    """

    def apart(factor: float) -> Array:
        other = truth_of(case, min(factor * tolerance, COARSE_ERROR), finer=False).trace
        return np.asarray(np.maximum.accumulate(np.abs(other.force_N - exact.force_N).max(axis=1)))

    rough = apart(ROUGH_FACTOR)
    linear = share_of_change(rough, exact) < LINEAR_SHARE
    return np.maximum.accumulate(np.where(linear, rough / ROUGH_FACTOR, 0.0 if linear.all() else apart(NEAR_FACTOR)))


def quantities(case: Case, trace: Trace) -> dict[str, float]:
    """What a trace shows of pulses, by name without the unit."""
    values = observe(case.layout, trace).items()
    return {without_unit(name): value for name, value in values if describe(name).of_wave and np.isfinite(value)}


def errors_of(case: Case, trace: Trace, truth: Truth, names: Collection[str]) -> dict[str, float]:
    """Errors of the named quantities; inf for one that the trace does not show.

    Raises:
        KeyError: the truth does not show it either.
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
    """Error of the energy at each sample; where contacts lose some, from the exact motion's if that is known."""
    if chain.damped and exact is not None:
        return np.asarray(np.abs(trace.total_energy_J - exact.total_energy_J))
    return energy_error_J(trace.total_energy_J, damped=chain.damped, slips=chain.slips)


def momentum_error(case: Case, trace: Trace, truth: Truth) -> float:
    """Largest momentum difference over the largest momentum."""
    scale = max(float(np.abs(truth.trace.momentum_N_s).max()), moving_at_start(case.chain)) or 1.0
    return float(np.abs(trace.momentum_N_s - truth.trace.momentum_N_s).max()) / scale
