"""Predicted errors of a run and the tolerances derived from them.

By the triangle inequality ``|run - exact| <= |scheme - exact| + |run - scheme|``. The first term is the error of the
scheme at the step of the run, computed in this repository; the second is bounded by rounding. No engine predicts its
own errors. With Q_h velocity Verlet at the step h, p its order, ``g = 1 / (2^p - 1)`` and Richardson's extrapolation
``Q_0 = Q_h/8 + g (Q_h/8 - Q_h/4)`` the predicted motion is

* for a code: ``Q_h``;
* for ``verlet``: the exact motion plus ``Q_h - Q_0``, which fails for a scheme of another order or other equations;
* for an engine without a time step: ``Q_0``.

The tolerance of the last two includes the remainder of the series at the step h,
``g |g (Q_h - Q_h/2) - (1 + g) (Q_h/2 - Q_h/4)|``. This exceeds the remainder at h/8, of which only the order is known,
as contacts open and close between steps.
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
from validation.accuracy.exact_motion import ENERGY, energy_change_J

IMPULSE = "impulse"
KINDS = ("peak", "speed")  # of predicted observables
REASON = "the error of velocity Verlet at this step, computed in this repository, plus rounding"
EXACT_REASON = "the error of an exact run, from velocity Verlet extrapolated to a step of zero, plus rounding"


@dataclass(frozen=True)
class Prediction:
    """Errors of a faultless run.

    Attributes:
        errors: by quantity, as in ``run_errors``; empty if nothing can be predicted.
        rest: upper bounds on rounding and on the uncertainty of the prediction, by quantity.
        scheme: text on the source of the prediction, with ``{}`` for the error.
        rest_source: text on the source of the rest.
        reason: reason of the tolerances.
        capped: True if the general tolerance is an upper limit.
    """

    errors: dict[str, float]
    rest: dict[str, float]
    scheme: str = ""
    rest_source: str = ""
    reason: str = ""
    capped: bool = True

    def tolerance(self, quantity: str, general: Tolerance) -> tuple[Tolerance, str]:
        """Tolerance of a quantity and text on its parts: error plus rest, or the general tolerance if that is less."""
        if quantity not in self.errors:
            return general, ""
        error, rest = self.errors[quantity], self.rest[quantity]
        words, limit = f"; {self.scheme.format(f'{error:.1e}')}", error + rest
        if isfinite(limit) and (limit < general.limit or not self.capped):
            return Tolerance(limit, self.reason, error), f"{words}, {self.rest_source} up to {rest:.0e}"
        return general, words


def predict(baseline: Baseline, engine: str, *, capped: bool = True) -> Prediction:
    """Predict the errors of a run of an engine, at the samples at which the exact motion is known."""
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
    scheme, source = f"velocity Verlet at {step_s * 1e6:g} µs has an error of {{}}", "rounding adds"
    if runs.scheme == EXACT:
        scheme, source = "velocity Verlet extrapolated to a step of zero has {}", "extrapolation and rounding add"
    elif runs.in_repository:
        scheme, source = "runs at 1/2, 1/4 and 1/8 of the step predict {}", "extrapolation and rounding add"
    sphere = "" if model_quantity(baseline.case) == FORCE else f"; {baseline.model_tolerance.reason}"
    return Prediction(
        errors,
        {name: share * rest for name, share in shares.items()},
        scheme,
        source,
        (EXACT_REASON if runs.scheme == EXACT else REASON) + sphere,
        capped=capped,
    )


def predicted_motion(baseline: Baseline, engine: str) -> tuple[Trace, float] | None:
    """Predicted motion of a faultless run and its uncertainty over the largest change, while the exact motion is known.

    None if the exact motion is not known, or if only the engine itself models the scene.
    """
    runs = load_engine(engine)
    by_code = runs.scheme != EXACT and not runs.in_repository
    if baseline.why_unknown or not (by_code or baseline.straight):
        return None
    try:
        exact = baseline.exact
    except ArithmeticError:
        return None
    samples = len(exact.time_s)
    plain, allowed = until(baseline.plain, samples), baseline.model_tolerance.limit
    if by_code:
        return plain, max(allowed, float(baseline.rounding_bound[samples - 1]))
    if runs.scheme == EXACT:
        allowed = max(allowed, float(baseline.exact_error[samples - 1]))
    half, quarter, eighth = (until(each, samples) for each in (baseline.half, baseline.quarter, baseline.eighth))
    gain = 1 / (2**baseline.order - 1)
    rest_N = gain * (gain * (plain.force_N - half.force_N) - (1 + gain) * (half.force_N - quarter.force_N))
    allowed += float(share_of_change(np.abs(rest_N).max(), exact))
    if runs.scheme == EXACT:
        return _sum((1 + gain, eighth), (-gain, quarter)), allowed
    return _sum((1.0, exact), (1.0, plain), (-1 - gain, eighth), (gain, quarter)), allowed


def _sum(*terms: tuple[float, Trace]) -> Trace:
    """Weighted sum of traces, without positions and velocities of bodies."""
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
    """Errors of a run by quantity: energy and impulse; with an exact motion also force, peaks and speeds.

    * force: largest difference over the largest change;
    * energy: largest change over the largest kinetic energy;
    * impulse: largest ``|p - p(0) - impulse of wall and loads|`` over the largest momentum, as sampled;
    * peak: relative to the dynamic peak of the gauge; speed: relative. NaN if the run lacks the observable.

    Args:
        baseline: baseline of the case.
        trace: the run, or its first samples.
        exact: exact motion at the same samples; None if it is not known.
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
