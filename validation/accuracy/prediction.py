"""Prediction of a run's errors by the scheme of its engine, and the tolerances that follow from it.

By the triangle inequality ``|run - exact| <= |scheme - exact| + |run - scheme|``: the first is what the scheme does at
the step of the run, computed in this repository, the second what rounding allows. What computed a run does not predict
its errors: with Q_h velocity Verlet at the step h and Richardson's extrapolation ``Q_0 = Q_h/8 + g (Q_h/8 - Q_h/4)``,
``g = 1 / (2^p - 1)``, p its order, the prediction of the motion is

* of a code ``Q_h``;
* of ``verlet`` the exact motion and ``Q_h - Q_0``, which no scheme of another order or of other equations fulfils;
* of an engine without a time step ``Q_0``.

The last two hold to the rest of the series, ``g |g (Q_h - Q_h/2) - (1 + g) (Q_h/2 - Q_h/4)|`` at the step h: more than
what h/8 leaves, of which no more than the order is known, as contacts open and close between steps.
"""

from dataclasses import dataclass, fields
from math import isfinite

import numpy as np

from drivers.base.tolerances import Tolerance, tolerance
from drivers.chain.trace import Trace, until
from drivers.engines import EXACT, load_engine
from drivers.limits.refusal import FORCE
from postproc.read.observables import observe, of_kind, scale_of
from postproc.read.residual import largest_change_N, residual, share_of_change
from validation.accuracy.baseline import Baseline, model_quantity
from validation.accuracy.schemes import ENERGY, energy_change_J

IMPULSE = "impulse"
KINDS = ("peak", "speed")  # of observables that are predicted
REASON = "the error of velocity Verlet at this step, computed in this repository, and what rounding adds"
EXACT_REASON = "the error of an exact run, by velocity Verlet extrapolated to a step of zero, and what rounding adds"


@dataclass(frozen=True)
class Prediction:
    """Errors that a run without faults has.

    Attributes:
        errors: by quantity, as ``run_errors``; empty where nothing can be predicted.
        rest: what rounding, and what the prediction leaves open, add at most, likewise.
        scheme: what predicts them, in words, with ``{}`` for a number.
        beside: what the rest is, in words.
        reason: of the tolerances.
        capped: whether a run may be off by no more than the general tolerance.
    """

    errors: dict[str, float]
    rest: dict[str, float]
    scheme: str = ""
    beside: str = ""
    reason: str = ""
    capped: bool = True

    def tolerance(self, quantity: str, general: Tolerance) -> tuple[Tolerance, str]:
        """Tolerance of a quantity, error and rest or the general one where that is less; both parts in words."""
        if quantity not in self.errors:
            return general, ""
        error, rest = self.errors[quantity], self.rest[quantity]
        words, limit = f"; {self.scheme.format(f'{error:.1e}')}", error + rest
        if isfinite(limit) and (limit < general.limit or not self.capped):
            return Tolerance(limit, self.reason, error), f"{words}, {self.beside} up to {rest:.0e}"
        return general, words


def predict(baseline: Baseline, engine: str, *, capped: bool = True) -> Prediction:
    """Prediction for a run of an engine, at the samples at which the exact motion is known."""
    found = predicted_motion(baseline, engine)
    if found is None:
        return Prediction({}, {})
    motion, rest = found
    with np.errstate(over="ignore", invalid="ignore"):  # too large a step blows up
        errors = run_errors(baseline, motion, baseline.exact)
        values = observe(baseline.case.layout, baseline.exact)
    others, change_N = tolerance("between", "others").limit, largest_change_N(baseline.exact.force_N)
    shares = {name: 1.0 if name == FORCE else others for name in errors}
    shares |= {name: max(others, change_N / scale_of(name, values)) for name in of_kind(errors, "peak")}
    runs, step_s = load_engine(engine), baseline.case.scene.time_step_s
    scheme, beside = f"velocity Verlet at {step_s * 1e6:g} µs is off by {{}} itself", "rounding adds"
    if runs.scheme == EXACT:
        scheme, beside = "velocity Verlet at a step of zero shows {}", "extrapolation and rounding add"
    elif runs.in_repository:
        scheme, beside = "runs at 1/2, 1/4 and 1/8 of the step predict {}", "extrapolation and rounding add"
    sphere = "" if model_quantity(baseline.case) == FORCE else f"; {baseline.stated.reason}"
    return Prediction(
        errors,
        {name: share * rest for name, share in shares.items()},
        scheme,
        beside,
        (EXACT_REASON if runs.scheme == EXACT else REASON) + sphere,
        capped=capped,
    )


def predicted_motion(baseline: Baseline, engine: str) -> tuple[Trace, float] | None:
    """Motion of a run without faults, by what did not compute it, and by what share of the change it may differ.

    As long as the exact motion is known; None where it is not, or where nothing else than the engine knows the scene.
    """
    runs = load_engine(engine)
    by_code = runs.scheme != EXACT and not runs.in_repository
    if baseline.unknown or not (by_code or baseline.straight):
        return None
    try:
        exact = baseline.exact
    except ArithmeticError:
        return None
    samples = len(exact.time_s)
    plain, allowed = until(baseline.plain, samples), baseline.stated.limit
    if by_code:
        return plain, max(allowed, float(baseline.explained[samples - 1]))
    if runs.scheme == EXACT:
        allowed = max(allowed, float(baseline.known[samples - 1]))
    half, quarter, eighth = (until(each, samples) for each in (baseline.half, baseline.quarter, baseline.eighth))
    gain = 1 / (2**baseline.order - 1)
    rest_N = gain * (gain * (plain.force_N - half.force_N) - (1 + gain) * (half.force_N - quarter.force_N))
    allowed += float(share_of_change(np.abs(rest_N).max(), exact))
    if runs.scheme == EXACT:
        return _sum((1 + gain, eighth), (-gain, quarter)), allowed
    return _sum((1.0, exact), (1.0, plain), (-1 - gain, eighth), (gain, quarter)), allowed


def _sum(*terms: tuple[float, Trace]) -> Trace:
    """Sum of traces with weights, without places and velocities of bodies."""
    names = {each.name for each in fields(Trace)} - {
        "time_s",
        "height_m",
        "velocity_m_s",
        "sideways",
        "bore_friction_N",
    }
    sums = {name: sum(weight * getattr(trace, name) for weight, trace in terms) for name in names}
    return Trace(terms[0][1].time_s, **sums)


def run_errors(baseline: Baseline, trace: Trace, exact: Trace | None = None) -> dict[str, float]:
    """Errors of a run by quantity: energy and impulse, and against an exact motion force, peaks and speeds.

    The force's is the largest difference over the largest change, the energy's the largest change over the largest
    kinetic energy, the impulse's the largest ``|p - p(0) - impulse of wall and loads|`` over the largest momentum, as
    sampled. Peaks are over their gauge's wave, speeds over their own; NaN where a run does not show them.

    Args:
        baseline: of the case.
        trace: the run, or the first samples of it.
        exact: at the same samples; None where it is not known.
    """
    case, values = baseline.case, observe(baseline.case.layout, trace)
    energy = float(energy_change_J(case.chain, trace, None).max()) / baseline.energy_scale_J(trace)
    errors = {ENERGY: energy, IMPULSE: values["impulse_imbalance_share"]}
    if exact is not None:
        should = observe(case.layout, exact)
        errors[FORCE] = float(residual(trace, exact).max())
        for name in of_kind(should, *KINDS):
            if np.isfinite(should[name]) and scale_of(name, should):
                errors[name] = abs(values[name] - should[name]) / scale_of(name, should)
    return errors
