"""The error budget of a run, whose parts add up to the whole, and what the run is warned of.

With Q a quantity as the engine's run shows it, Q_h by its own scheme at the same step (velocity Verlet in absolute
heights), Q_v the same in overlaps, Q_e exact at the same samples and Q_t true (from finer samples):

* model = Q - Q_h: rounding in another order, unless something is wrong;
* rounding = Q_h - Q_v: of absolute coordinates;
* truncation = Q_v - Q_e: what the time step costs;
* sampling = Q_e - Q_t: a peak read from samples.

In three dimensions Q_e is extrapolated, rounding is part of the model's and sampling is not measured.
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
from postproc.read.residual import beside, residual, share_of_change, still
from validation.accuracy.baseline import HORIZON, Baseline, Extrapolation, baseline_of
from validation.accuracy.schemes import Truth, energy_change_J, errors_of, quantities, truth_of

NOTHING_MOVES = "nothing moves: errors are shares of the largest force"
PARTS = ("whole", "model", "rounding", "truncation", "sampling")


def error_budget(case: Case, engine: str, trace: Trace) -> tuple[list[dict[str, Any]], str]:
    """The parts of the error of the force and of all quantities a run shows, and why some or all are left out."""
    baseline = baseline_of(case, engine)
    if baseline.unknown:
        return [], baseline.unknown
    try:
        exact = baseline.exact
    except ArithmeticError as error:
        return [], f"not measured: {error}"
    parts, unseen = parts_of(baseline, engine, until(trace, len(exact.time_s)))
    lacks = [f"not in the run, but in the exact motion: {', '.join(unseen)}"] if unseen else []
    return parts, "; ".join([*_notes(baseline, engine), *lacks])


def measured_errors(case: Case, trace: Trace, names: Collection[str]) -> dict[str, float]:
    """Errors of the named quantities of a run against the exact motion, which is known to its tolerance."""
    truth = truth_of(case.full) if case.full else baseline_of(case).followed  # accuracies are of straight chains
    known = float(share_of_change(truth.known_N, truth.trace)[-1])
    return {name: max(error, known) for name, error in errors_of(case, trace, truth, names).items()}


def parts_of(baseline: Baseline, engine: str, trace: Trace) -> tuple[list[dict[str, Any]], list[str]]:
    """The parts of the error of each quantity, the force first; and what the run should show and does not."""
    truth, exact, scheme = baseline.truth, baseline.exact, baseline.scheme_of(engine)
    if isinstance(truth, Truth):
        stages = (trace, scheme, exact if scheme is exact else baseline.in_overlaps, exact)
    else:
        stages = (trace, scheme, truth.half, truth.quarter)
    difference = np.nan_to_num(np.abs(trace.force_N - exact.force_N), nan=np.inf)
    sample, column = np.unravel_index(int(np.argmax(difference)), difference.shape)
    values = [float(stage.force_N[sample, column]) / baseline.scale_N for stage in stages]
    place = f"contact {column + 1} at {trace.time_s[sample] * 1e6:g} us"
    share = float(difference[sample, column]) / baseline.scale_N
    found = [_parts(FORCE, _rungs(values, truth), place + beside(share, exact.force_N))]

    seen = [quantities(baseline.case, stage) for stage in stages]
    if isinstance(truth, Truth):
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


def _rungs(values: list[float], truth: Truth | Extrapolation) -> list[float]:
    """A quantity of the run, by its scheme, in overlaps, exact and true, from what the stages show of it."""
    if isinstance(truth, Extrapolation):
        run, scheme, half, quarter = values
        true = truth.at_zero(half, quarter)
        return [run, scheme, scheme, true, true]
    return values if len(values) > 4 else [*values, values[-1]]


def _parts(quantity: str, shares: list[float], where: str = "") -> dict[str, Any]:
    """Signed parts of the error of a quantity, in shares of the true value; of the force with its contact and time."""
    run, scheme, overlaps, exact, true = shares
    parts = run - true, run - scheme, scheme - overlaps, overlaps - exact, exact - true
    return {"quantity": quantity, **dict(zip(PARTS, parts, strict=True)), "where": where}


def _notes(baseline: Baseline, engine: str) -> Iterator[str]:
    """What a budget leaves out."""
    truth, case = baseline.truth, baseline.case
    if still(baseline.exact.force_N):
        yield NOTHING_MOVES
    if isinstance(truth, Truth):
        if not truth.sampling_known:
            yield "sampling not measured: too many samples"
        if load_engine(engine).scheme == EXACT or len(truth.trace.time_s) < case.scene.samples:
            yield known_to(baseline)
        return
    converging = f"which converge with order {truth.order:.2g}"
    yield f"truncation by extrapolation from half and a quarter of the step, {converging}"
    yield f"rounding is part of model: alone it makes up to {baseline.explained[baseline.samples - 1]:.1g} of the force"
    yield "sampling not measured"
    if baseline.samples < case.scene.samples:
        end = case.sample_times_s[baseline.samples - 1]
        yield f"measured until t = {end:g} s, from when on rounding alone parts two runs"


def known_to(baseline: Baseline) -> str:
    """How exact the exact motion of a straight chain is, in words."""
    samples, times = len(baseline.exact.time_s), baseline.case.sample_times_s
    if samples == len(times):
        return f"exact to {baseline.known[-1]:.0e} of the largest change, by a second run at another tolerance"
    return (
        f"the exact motion is known to {HORIZON:g} of the largest change until t = {times[samples - 1]:g} s, and at the"
        f" end to {baseline.known[-1]:.1g}, since it multiplies rounding: nothing is measured beyond"
    )


def for_terminal(error_budget: Iterable[dict[str, Any]]) -> Iterator[tuple[str, str]]:
    """Quantity and numbers of the lines that a terminal shows of a record's budget: of the force and of peaks.

    Records of other versions may lack some parts: these lines are left out.
    """
    for each in error_budget:
        quantity = each["quantity"]
        if (quantity == "force" or of_kind([quantity], "peak")) and set(PARTS) <= each.keys():
            yield quantity, " ".join(f"{each[part]:10.1e}" for part in PARTS)


def warnings_of(case: Case, engine: str, trace: Trace) -> list[str]:
    """What to say of a run that is done and of little use; nothing of most."""
    if case.chain.lateral is not None and baseline_of(case, engine).unknown:
        return []
    try:
        return [*_warnings(case, engine, trace)]
    except ArithmeticError as failed:
        return [f"its error cannot be predicted: {failed}"]


def _warnings(case: Case, engine: str, trace: Trace) -> Iterator[str]:
    """Where the energy, or the error that is predicted, passes a tenth, and a code its scheme by more than rounding."""
    error, limit = predicted_error(case, engine), tolerance("warning", "force").limit
    beyond = error > limit
    if beyond.any():
        since = case.sample_times_s[int(np.argmax(beyond))]
        by_step = case.chain.lateral is not None or predicted_error(case, VERLET).max() > limit
        why = "the time step" if by_step else "the rounding of heights so far from 0"
        yield (
            f"forces are predicted to be off by up to {error.max():.2g} of the largest change, by more than {limit:g}"
            f" from t = {since:g} s on, by {why}"
        )
    baseline = baseline_of(case, engine)
    exact = baseline.followed.trace if baseline.straight and not baseline.unknown else None
    change_J = energy_change_J(case.chain, trace, exact)
    share, limit = change_J / baseline.energy_scale_J(trace), tolerance("warning", "energy").limit
    if not (share <= limit).all():
        since = case.sample_times_s[int(np.argmax(~(share <= limit)))]
        yield (
            f"the energy is off by up to {share.max():.2g} of the largest kinetic energy, by more than {limit:g} from"
            f" t = {since:g} s on"
        )
    if load_engine(engine).scheme == EXACT and exact is not None and baseline.known[-1] > HORIZON:
        yield known_to(baseline)
    if load_engine(engine).in_repository or baseline.unknown:
        return
    allowed = baseline.allowed.limit
    apart = residual(trace, baseline.plain)[: baseline.samples]
    if not (apart <= allowed).all():
        since = case.sample_times_s[int(np.argmax(~(apart <= allowed)))]
        yield (
            f"forces differ from velocity Verlet at the same step by {apart.max():.2g} of the largest change, from"
            f" t = {since:g} s on, where rounding explains {allowed:.1g}: what ran is not what the scene says"
        )


def predicted_error(case: Case, engine: str) -> Array:
    """Largest force error by the engine's scheme at each sample where that is known, over the largest change of force.

    Against the exact motion; of chains that are too long for it, against the same scheme at half the step.

    Raises:
        ArithmeticError: the exact motion cannot be followed.
    """
    baseline = baseline_of(case, engine)
    with np.errstate(over="ignore", invalid="ignore"):  # too large a step blows up
        if not baseline.unknown:
            error = residual(baseline.scheme_of(engine), baseline.exact)
        elif load_engine(engine).scheme == EXACT:
            error = np.zeros(case.scene.samples)
        else:  # it goes with the step squared, or where contacts lose energy with the step
            error = residual(baseline.plain, baseline.half) * (2 if case.chain.damped else 4 / 3)
    return np.nan_to_num(error, nan=np.inf)
