"""Error budget of a run and its warnings.

Values of a quantity: Q of the engine's run, Q_h of its own scheme at the same step (velocity Verlet in absolute
heights), Q_v of velocity Verlet in overlaps, Q_e exact at the same samples, Q_t true (exact, from finer samples).
The parts of the error add up to the whole Q - Q_t:

* model = Q - Q_h: rounding in another order of addition, unless something is wrong;
* rounding = Q_h - Q_v: rounding of absolute coordinates;
* truncation = Q_v - Q_e: error of the time step, of ``reference`` error of its tolerance;
* sampling = Q_e - Q_t: error of a peak read from samples.

In three dimensions Q_e is extrapolated, rounding is included in model, and sampling is not measured.
"""

from collections.abc import Collection, Iterable, Iterator
from typing import Any

import numpy as np

from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace, until
from drivers.engines import EXACT, VERLET, load_engine
from drivers.limits.refusal import FORCE
from postproc.read.observables import of_kind, scale_of
from postproc.read.residual import is_at_rest, residual, share_of_change, static_load_remark
from validation.accuracy.baseline import HORIZON, Baseline, Extrapolation, baseline_of
from validation.accuracy.exact_motion import ExactMotion, energy_change_J, errors_of, exact_motion_of, quantities

AT_REST_NOTE = "nothing moves: errors are relative to the largest force"
PARTS = ("whole", "model", "rounding", "truncation", "sampling")
BUDGET_WORDS = "signed parts that add up to the whole: model, rounding, truncation (time step), sampling"


def error_budget(case: Case, engine: str, trace: Trace) -> tuple[list[dict[str, Any]], str]:
    """Parts of the error of the force and of each quantity of a run; and a note on parts that were not measured."""
    baseline = baseline_of(case, engine)
    if baseline.why_unknown:
        return [], baseline.why_unknown
    try:
        exact = baseline.exact
    except ArithmeticError as error:
        return [], f"not measured: {error}"
    parts, unseen = parts_of(baseline, engine, until(trace, len(exact.time_s)))
    lacks = [f"missing in the run, present in the exact motion: {', '.join(unseen)}"] if unseen else []
    return parts, "; ".join([*_notes(baseline, engine), *lacks])


def measured_errors(case: Case, trace: Trace, names: Collection[str]) -> dict[str, float]:
    """Errors of the named quantities of a run against the exact motion, at least the error of the exact motion."""
    truth = exact_motion_of(case.full) if case.full else baseline_of(case).exact_to_end
    known = float(share_of_change(truth.error_N, truth.trace)[-1])
    return {name: max(error, known) for name, error in errors_of(case, trace, truth, names).items()}


def parts_of(baseline: Baseline, engine: str, trace: Trace) -> tuple[list[dict[str, Any]], list[str]]:
    """Parts of the error of each quantity, the force first; and quantities missing in the run."""
    truth, exact, scheme = baseline.exact_motion, baseline.exact, baseline.scheme_of(engine)
    if isinstance(truth, ExactMotion):
        stages = (trace, scheme, scheme if scheme is baseline.reference else baseline.in_overlaps, exact)
    else:
        stages = (trace, scheme, truth.half, truth.quarter)
    difference = np.nan_to_num(np.abs(trace.force_N - exact.force_N), nan=np.inf)
    sample, column = np.unravel_index(int(np.argmax(difference)), difference.shape)
    values = [float(stage.force_N[sample, column]) / baseline.scale_N for stage in stages]
    place = f"contact {column + 1} at {trace.time_s[sample] * 1e6:g} us"
    share = float(difference[sample, column]) / baseline.scale_N
    found = [_parts(FORCE, _rungs(values, truth), place + static_load_remark(share, exact.force_N))]

    seen = [quantities(baseline.case, stage) for stage in stages]
    if isinstance(truth, ExactMotion):
        seen.append(truth.true)
    unseen = []
    for name in seen[-1]:
        if all(name in stage for stage in seen):
            static = abs(seen[-1][name]) - scale_of(name, seen[-1])
            scale = abs(_rungs([stage[name] for stage in seen], truth)[-1]) - static
            if scale > 0:
                found.append(_parts(name, _rungs([stage[name] / scale for stage in seen], truth)))
        elif seen[-1][name] and name not in seen[0]:
            unseen.append(name)
    return found, unseen


def _rungs(values: list[float], truth: ExactMotion | Extrapolation) -> list[float]:
    """Values [Q, Q_h, Q_v, Q_e, Q_t] of a quantity, from its values in each stage."""
    if isinstance(truth, Extrapolation):
        run, scheme, half, quarter = values
        true = truth.at_zero(half, quarter)
        return [run, scheme, scheme, true, true]
    return values if len(values) > 4 else [*values, values[-1]]


def _parts(quantity: str, shares: list[float], where: str = "") -> dict[str, Any]:
    """Signed parts of the error of a quantity, relative to the true value; for the force with contact and time."""
    run, scheme, overlaps, exact, true = shares
    parts = run - true, run - scheme, scheme - overlaps, overlaps - exact, exact - true
    return {"quantity": quantity, **dict(zip(PARTS, parts, strict=True)), "where": where}


def _notes(baseline: Baseline, engine: str) -> Iterator[str]:
    """Notes on parts of the budget that were not measured."""
    truth, case = baseline.exact_motion, baseline.case
    if is_at_rest(baseline.exact.force_N):
        yield AT_REST_NOTE
    if isinstance(truth, ExactMotion):
        if not truth.sampling_known:
            yield "sampling not measured: too many samples"
        if load_engine(engine).scheme == EXACT or len(truth.trace.time_s) < case.scene.samples:
            yield exactness_note(baseline)
        return
    yield f"truncation extrapolated from half and a quarter of the step (order of convergence {truth.order:.2g})"
    bound = baseline.rounding_bound[baseline.samples - 1]
    yield f"rounding is included in model: at most {bound:.1g} of the force"
    yield "sampling not measured"
    if baseline.samples < case.scene.samples:
        end = case.sample_times_s[baseline.samples - 1]
        yield f"measured until t = {end:g} s; later rounding alone separates two runs"


def exactness_note(baseline: Baseline) -> str:
    """Sentence on the error of the exact motion of a straight chain."""
    samples, times = len(baseline.exact.time_s), baseline.case.sample_times_s
    if samples == len(times):
        return f"exact to {baseline.exact_error[-1]:.0e} of the largest change, measured by a run at another tolerance"
    return (
        f"the exact motion is known to {HORIZON:g} of the largest change until t = {times[samples - 1]:g} s, and to"
        f" {baseline.exact_error[-1]:.1g} at the end, since the chain amplifies rounding errors; later errors are not"
        " measured"
    )


def budget_lines(error_budget: Iterable[dict[str, Any]]) -> Iterator[tuple[str, str]]:
    """Lines of the error budget for a terminal, force and peaks only: quantity and numbers.

    Lines with missing parts, in records of other versions, are left out.
    """
    for each in error_budget:
        quantity = each["quantity"]
        if (quantity == "force" or of_kind([quantity], "peak")) and set(PARTS) <= each.keys():
            yield quantity, " ".join(f"{each[part]:10.1e}" for part in PARTS)


def warnings_of(case: Case, engine: str, trace: Trace) -> list[str]:
    """Warnings on a finished run whose results are inaccurate; most runs have none."""
    if case.chain.lateral is not None and baseline_of(case, engine).why_unknown:
        return []
    try:
        return [*_warnings(case, engine, trace)]
    except ArithmeticError as failed:
        return [f"the error of this run cannot be predicted: {failed}"]


def _warnings(case: Case, engine: str, trace: Trace) -> Iterator[str]:
    """Warnings on predicted errors and energy changes above a tenth, and on codes that deviate from velocity Verlet."""
    error, limit = predicted_error(case, engine), tolerance("warning", "force").limit
    beyond = error > limit
    if beyond.any():
        since = case.sample_times_s[int(np.argmax(beyond))]
        by_step = case.chain.lateral is not None or predicted_error(case, VERLET).max() > limit
        why = "the time step" if by_step else "rounding of heights far from 0"
        yield (
            f"predicted force error of up to {error.max():.2g} of the largest change, above {limit:g} from"
            f" t = {since:g} s; cause: {why}"
        )
    baseline = baseline_of(case, engine)
    exact = baseline.exact_to_end.trace if baseline.straight and not baseline.why_unknown else None
    change_J = energy_change_J(case.chain, trace, exact)
    share, limit = change_J / baseline.energy_scale_J(trace), tolerance("warning", "energy").limit
    if not (share <= limit).all():
        since = case.sample_times_s[int(np.argmax(~(share <= limit)))]
        yield (
            f"energy error of up to {share.max():.2g} of the largest kinetic energy, above {limit:g} from"
            f" t = {since:g} s"
        )
    if load_engine(engine).scheme == EXACT and exact is not None and baseline.exact_error[-1] > HORIZON:
        yield exactness_note(baseline)
    if load_engine(engine).in_repository or baseline.why_unknown:
        return
    allowed = baseline.allowed.limit
    apart = residual(trace, baseline.plain)[: baseline.samples]
    if not (apart <= allowed).all():
        since = case.sample_times_s[int(np.argmax(~(apart <= allowed)))]
        yield (
            f"forces differ from velocity Verlet at the same step by up to {apart.max():.2g} of the largest change,"
            f" from t = {since:g} s; rounding explains {allowed:.1g}: the engine did not run the scene as written"
        )


def predicted_error(case: Case, engine: str) -> Array:
    """Largest force error of the engine's scheme at each sample, over the largest change of force. Shape (samples,).

    The error is measured against the exact motion; for chains too long for that, against half the step.

    Raises:
        ArithmeticError: the integrator of the exact motion fails.
    """
    baseline = baseline_of(case, engine)
    with np.errstate(over="ignore", invalid="ignore"):  # too large a step blows up
        if not baseline.why_unknown:
            error = residual(baseline.scheme_of(engine), baseline.exact)
        elif load_engine(engine).scheme == EXACT:
            error = np.zeros(case.scene.samples)
        else:  # second order in the step; first order with damping
            error = residual(baseline.plain, baseline.half) * (2 if case.chain.damped else 4 / 3)
    return np.nan_to_num(error, nan=np.inf)
