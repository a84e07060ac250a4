"""Errors of a run by quantity: of the whole force trace, of the energy, and of observables read from the samples.

Quantities are named like observables, without the unit: ``wall_peak``, ``bead_9_arrival``, ``speed_9_to_5``. The error
of ``force`` is the largest force difference over all contacts and sample times over the largest force, that of
``energy`` the largest change over what the scene puts in (where contacts lose energy, the largest difference); all
others are relative to the true value.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import arrays_of, energy_put_in, moving_at_start
from drivers.chain.trace import Trace
from drivers.limits.refusal import FORCE
from drivers.run.guard import energy_error
from postproc.read.observables import describe, observe, without_unit
from postproc.read.residual import residual
from validation.accuracy.schemes import trace_of
from validation.reference.adaptive import LEAST_TOLERANCE, integrate_adaptive
from validation.reference.hertz_chain import Motion

ENERGY = "energy"
FINER = 4  # times the samples that true peaks are read from: quintics leave 4^-6 of the error of sampling
MAX_FINE_VALUES = 4_000_000  # values of the finer record; beyond it the error of sampling is not measured


@dataclass(frozen=True)
class Truth:
    """A case's exact motion.

    Attributes:
        trace: at the case's sample times.
        fine: four times as fine; the same as ``trace`` where that would be too much.
    """

    case: Case
    trace: Trace
    fine: Trace

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


def truth_of(case: Case, tolerance: float = LEAST_TOLERANCE, *, finer: bool = True) -> Truth:
    """The exact motion of a case, good to ``tolerance`` of the largest force.

    Raises:
        ArithmeticError: it cannot be followed.
    """
    factor = FINER if finer and FINER * case.scene.samples * case.chain.bodies <= MAX_FINE_VALUES else 1
    spacing = case.scene.steps_per_sample * case.scene.time_step_s / factor
    time = np.arange(factor * (case.scene.samples - 1) + 1, dtype=float) * spacing
    motion = integrate_adaptive(arrays_of(case.chain), time, tolerance)
    fine = trace_of(case, time, motion)
    if factor == 1:
        return Truth(case, fine, fine)
    kept = Motion(*(values[::factor] for values in (motion.force_N, motion.displacement_m, motion.velocity_m_s)))
    return Truth(case, trace_of(case, case.sample_times_s, kept), fine)


def quantities(case: Case, trace: Trace) -> dict[str, float]:
    """What a trace shows of pulses, by name without the unit."""
    values = observe(case.layout, trace).items()
    return {without_unit(name): value for name, value in values if describe(name).of_wave and np.isfinite(value)}


def errors_of(case: Case, trace: Trace, truth: Truth, names: Iterable[str]) -> dict[str, float]:
    """Errors of the named quantities; inf for one that the trace does not show.

    Raises:
        KeyError: the truth does not show it either.
    """
    errors = {}
    seen: dict[str, float] | None = None
    for name in names:
        if name == FORCE:
            errors[name] = float(residual(trace, truth.trace).max())
        elif name == ENERGY:
            errors[name] = _energy_error(case, trace, truth)
        else:
            seen = quantities(case, trace) if seen is None else seen
            errors[name] = abs(seen.get(name, np.inf) / truth.true[name] - 1)
    return {name: error if np.isfinite(error) else np.inf for name, error in errors.items()}


def _energy_error(case: Case, trace: Trace, truth: Truth) -> float:
    """Largest change of the energy over what the scene puts in; where it is lost, its largest difference."""
    if not case.chain.damping_ratio:
        return float(energy_error(case.chain, trace).max())
    scale = energy_put_in(case.chain, float(trace.time_s[-1])) or 1.0
    return float(np.abs(trace.total_energy_J - truth.trace.total_energy_J).max()) / scale


def momentum_error(case: Case, trace: Trace, truth: Truth) -> float:
    """Largest momentum difference over the largest momentum."""
    scale = max(float(np.abs(truth.trace.momentum_N_s).max()), moving_at_start(case.chain)) or 1.0
    return float(np.abs(trace.momentum_N_s - truth.trace.momentum_N_s).max()) / scale
