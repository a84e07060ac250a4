"""Error budget of a run: one table of the parts of its errors, and the two judgements on it.

Values of a quantity: Q of the engine's run, Q_h of its own scheme at the same step (velocity Verlet in absolute
heights), Q_v of velocity Verlet in overlaps, Q_e exact at the same samples, Q_t true (exact, from finer samples, with
all elements of the scene). The parts of the error add up to the whole Q - Q_t:

* model = Q - Q_h: rounding in another order of addition, unless something is wrong;
* rounding = Q_h - Q_v: rounding of absolute coordinates;
* truncation = Q_v - Q_e: error of the time step, of ``reference`` error of its tolerance;
* sampling = Q_e - Q_t: error of a peak read from samples;
* elements, if an accuracy left some out: their effect.

The table has a row for the forces of all contacts, the change of the total energy, the momentum, and each observable.
Two judgements follow. *Is it the right computation?* The model part of forces, energy and momentum at all samples is
within the limit that rounding explains; observables are functions of the forces, so theirs follows. *Is it accurate
enough?* The whole error is within the accuracy that the scene asks for, else within the general ceiling of
``inputs/tolerances.toml``. By the triangle inequality nothing else needs a verdict: a run that is right errs as its
scheme does, plus rounding.

In three dimensions Q_e is extrapolated, rounding is included in model, and sampling is not measured.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import chain, pairwise
from typing import Any

import numpy as np

from drivers.base.errors import digits_apart
from drivers.base.kept import kept
from drivers.base.text_table import text_table
from drivers.base.tolerances import Tolerance, tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace, energy_error_J, until
from drivers.engines import EXACT, load_engine
from drivers.limits.refusal import FORCE
from drivers.run.run_folder import EndedRun
from postproc.read.observables import of_kind, scale_of
from postproc.read.residual import is_at_rest, share_of_change, static_load_remark
from validation.accuracy.exact_motion import errors_of, quantities
from validation.accuracy.measured_law import SIGNIFICANCE, measure_law
from validation.accuracy.motions import FIELDS, HORIZON, Motions, judged_until, motions_of, predicted_error
from validation.checks import FAIL, Check, judged, worst_of

AT_REST_NOTE = "nothing moves: errors are relative to the largest force"
PARTS = ("whole", "model", "rounding", "truncation", "sampling")
ELEMENTS = "elements"
BUDGET_WORDS = "relative errors; model, rounding, truncation (time step) and sampling add up to the whole"
MODEL, ERROR = "model", "error"  # judgements: the right computation, accurate enough
LAW_REASON = f"{SIGNIFICANCE:g} times the uncertainty of the measured value, by rounding, time step and sampling"
CAUSES = {
    "model": "the run is not that of its scheme",
    "rounding": "rounding of heights far from 0",
    "truncation": "the time step",
    "sampling": "the interval between samples",
}
CEILINGS = {"peak": "peaks", "speed": "speeds"}  # kinds of observables that have a general ceiling, with their plural


@dataclass(frozen=True)
class Budget:
    """Errors of a run and the judgements on them.

    Attributes:
        rows: quantity, its parts as in ``PARTS``, and ``where`` for forces, energy and momentum; empty if the exact
            motion is not known.
        checks: the two judgements.
        note: parts that were not measured, with the reason.
        departure: first time and contact at which the model part passes its limit; empty if it never does.
        warnings: reasons why the run is of little use; most runs have none.
        exact_to: error of the exact motion until ``exact_until_s``, divided by the largest change of force; None for
            three-dimensional chains.
    """

    rows: list[dict[str, Any]]
    checks: list[Check]
    note: str
    departure: str
    warnings: list[str]
    exact_to: float | None
    exact_until_s: float | None


def kept_budget(case: Case, run: EndedRun) -> Budget:
    """Budget of a finished run, from the cache or computed and stored there; checks have the scene's name."""
    record, engine = run.record, load_engine(run.record.engine)
    scenes = [variant.scene.model_dump(mode="json") for variant in (case, case.full) if variant]
    depends_on = ["budget", scenes, engine.name, engine.scheme, engine.shear, record.build_sha256, run.forces_sha256]
    stored = kept(depends_on, lambda: asdict(budget_of(case, engine.name, run.trace)))
    checks = [Check(**check | {"scene": case.scene.name}) for check in stored["checks"]]
    return Budget(**stored | {"checks": checks})


def budget_of(case: Case, engine: str, trace: Trace) -> Budget:
    """Budget of a run of a case on an engine, from its trace at all samples of the case."""
    motions = motions_of(case, engine)
    with np.errstate(over="ignore", invalid="ignore"):  # too large a step blows up
        rows, missing = _rows(motions, engine, trace)
        departure = first_departure(case, engine, trace)
        checks = [*_model_checks(case, engine, trace), *_error_checks(case, engine, trace, rows)]
        known = not motions.why_unknown and motions.straight
        samples = motions.known if known else 0
        return Budget(
            rows=rows,
            checks=checks,
            note="; ".join([*_notes(motions, engine), *missing]),
            departure=departure,
            warnings=[*_warnings(motions, engine, trace, checks, rows)],
            exact_to=float(motions.exact_error[samples - 1]) if known else None,
            exact_until_s=float(case.sample_times_s[samples - 1]) if known else None,
        )


def field_of(trace: Trace, quantity: str) -> Array:
    """Forces of all contacts, change of the energy, or momentum. Shape (samples, contacts) or (samples, 1)."""
    if quantity == FORCE:
        return trace.force_N
    column = getattr(trace, FIELDS[quantity])
    return np.asarray(column - column[0] if quantity == "energy" else column)[:, np.newaxis]


def apart(one: Array, other: Array, scale: float) -> Array:
    """Magnitude of the difference of two fields over the common samples, divided by a scale; inf for NaN."""
    samples = min(len(one), len(other))
    return np.nan_to_num(np.abs(one[:samples] - other[:samples]) / scale, nan=np.inf)


def largest_difference(
    quantity: str, trace: Trace, right: Trace, scale: float, limits: Array | None = None
) -> tuple[float, tuple[int, int], str]:
    """Largest difference of two motions at common samples: its size divided by a scale, sample and column, place.

    With limits at each sample, shape (samples,), the difference closest to its limit.
    """
    has, expected = field_of(trace, quantity), field_of(right, quantity)
    share = apart(has, expected, scale)
    of_limit = share if limits is None else share / limits[: len(share), np.newaxis]
    sample, column = map(int, np.unravel_index(int(np.argmax(of_limit)), of_limit.shape))
    size = float(share[sample, column])
    remark = static_load_remark(size, expected) if quantity == FORCE else ""
    return size, (sample, column), place_of(quantity, right.time_s, (sample, column)) + remark


def place_of(quantity: str, time_s: Array, place: tuple[int, int]) -> str:
    """Contact and time of a sample and column, as text."""
    contact = f"contact {place[1] + 1} " if quantity == FORCE else ""
    return f"{contact}at {time_s[place[0]] * 1e6:.6g} µs"


def _rows(motions: Motions, engine: str, trace: Trace) -> tuple[list[dict[str, Any]], list[str]]:
    """Parts of the error of each quantity; and a note on observables missing in the run."""
    if motions.why_unknown:
        return [], []
    exact, full, scheme = motions.exact, motions.full, motions.scheme_of(engine)
    samples = min(len(part.time_s) for part in (exact, full.exact if full else exact))
    same = not motions.straight or load_engine(engine).scheme == EXACT  # rounding is included in model, or nil
    stages = [until(part, samples) for part in (trace, scheme, scheme if same else motions.plain, exact)]
    stages += [stages[-1], *([until(full.exact, samples)] if full else [])]

    rows = []
    for quantity in (FORCE, *FIELDS):
        scale = (full or motions).scale(quantity)
        _, place, where = largest_difference(quantity, trace, stages[-1], scale)
        rows.append(_row(quantity, [float(field_of(stage, quantity)[place]) / scale for stage in stages], where))

    observed = [quantities(motions.case, stage) for stage in stages[:3]] + motions.values
    observed += [full.values[1]] if full else []
    missing = []
    for name, true in observed[-1].items():
        if all(name in values for values in observed):
            if scale := scale_of(name, observed[-1]):
                rows.append(_row(name, [values[name] / scale for values in observed]))
        elif true and name not in observed[0]:
            missing.append(name)
    return rows, [f"missing in the run, present in the exact motion: {', '.join(missing)}"] if missing else []


def _row(quantity: str, shares: list[float], where: str = "") -> dict[str, Any]:
    """Signed parts of the error of a quantity, from Q, Q_h, Q_v, Q_e, Q_t and with elements left out the full Q_t."""
    parts = [first - second for first, second in pairwise(shares)]
    names = (*PARTS[1:], ELEMENTS)
    return {
        "quantity": quantity,
        "whole": shares[0] - shares[-1],
        **dict(zip(names, parts, strict=False)),
        "where": where,
    }


def _model_checks(case: Case, engine: str, trace: Trace) -> Iterator[Check]:
    """Is it the right computation? Difference from the engine's scheme that is closest to its limit at its sample."""
    motions = motions_of(case, engine)
    scheme = until(motions.scheme_of(engine), motions.samples)
    for quantity in (FORCE, *FIELDS):
        scale, limits = motions.scale(quantity), motions.explained(quantity)
        size, (sample, _), where = largest_difference(quantity, trace, scheme, scale, limits)
        limit, where = motions.tolerance_at(quantity, sample), where + motions.until_horizon
        yield judged(case.scene.name, engine, f"{MODEL}: {quantity}", size, limit, where)
    if load_engine(engine).in_repository:
        yield from _law_check(case, engine)


def _law_check(case: Case, engine: str) -> Iterator[Check]:
    """Check of the law of an in-repo scheme, measured from its own motions, which are compared with no other scheme."""
    motions, exact = motions_of(case, engine), load_engine(engine).scheme == EXACT
    if motions.why_unknown or not motions.straight:
        return
    step_s = 0.0 if exact else case.scene.time_step_s
    try:
        measured = [motions.exact_to_end.fine] if exact else [motions.plain, motions.rounded]
        laws = [measure_law(case, motion, step_s) for motion in measured]
    except ValueError:  # too few samples
        return
    if not all(laws):  # nothing moves
        return
    row = max(chain.from_iterable(laws), key=lambda row: row.uncertainties_off)
    place = f" of contact or body {row.place}" if row.place else ""
    limit = Tolerance(float(SIGNIFICANCE * row.uncertainty), LAW_REASON)
    yield judged(case.scene.name, engine, f"{MODEL}: law", float(abs(row.ratio - 1)), limit, f"{row.quantity}{place}")


def _error_checks(case: Case, engine: str, trace: Trace, rows: list[dict[str, Any]]) -> Iterator[Check]:
    """Is it accurate enough? Whole errors against the accuracy of the scene, else against the general ceilings.

    An error is at least that of the exact motion.
    """
    motions = motions_of(case, engine)
    if case.plan is not None:
        truth = (motions.full or motions).exact_to_end
        known = float(share_of_change(truth.error_N, truth.trace)[-1])
        for name, error in errors_of(case, trace, truth, case.plan.asked).items():
            limit = Tolerance(case.plan.asked[name], "the accuracy that the scene asks for")
            where = "to the end of the run"
            yield judged(case.scene.name, engine, f"{ERROR}: {name}", max(error, known), limit, where)
        return
    what = "the error of the exact motion" if motions.straight else "rounding alone"
    end = judged_until(case, motions.known, f"{what} exceeds {HORIZON:g}") if rows else ""
    whole = {row["quantity"]: row for row in rows}
    ceilings = {FORCE: ("truncation", FORCE), "energy": ("energy", "drift")}
    for quantity, ceiling in ceilings.items() if rows else ():
        error, where = abs(whole[quantity]["whole"]), whole[quantity]["where"] + end
        yield judged(case.scene.name, engine, f"{ERROR}: {quantity}", error, tolerance(*ceiling), where)
    for kind, plural in CEILINGS.items():
        limit = tolerance("truncation", kind)
        alike = [
            judged(case.scene.name, engine, f"{ERROR}: {plural}", abs(whole[name]["whole"]), limit, name + end)
            for name in of_kind(whole, kind)
        ]
        if worst := worst_of(alike):
            yield worst


def first_departure(case: Case, engine: str, trace: Trace) -> str:
    """First time and contact at which a run, finished or failed, departs from its scheme; empty if it never does.

    A fault in the set-up shows at time 0 or before a wave arrives, a fault in the law or in a mass in the wave.
    """
    motions = motions_of(case, engine)
    samples = min(motions.samples, len(trace.time_s))
    scheme = until(motions.scheme_of(engine), samples)
    for quantity in (FORCE, *FIELDS):
        has, right, scale = field_of(trace, quantity)[:samples], field_of(scheme, quantity), motions.scale(quantity)
        share, allowed = apart(has, right, scale), motions.explained(quantity)
        beyond = share.max(axis=1) > allowed[: len(share)]
        if not beyond.any():
            continue
        sample = int(np.argmax(beyond))
        column = int(np.argmax(share[sample]))
        one, other = digits_apart(float(has[sample, column]), float(right[sample, column]))
        unit = {FORCE: "N", "energy": "J", "momentum": "N s"}[quantity]
        when = "from the start" if sample == 0 else f"from {case.sample_times_s[sample] * 1e6:.6g} µs"
        if sample and quantity == FORCE:
            change = np.abs(right[: sample + 1, column] - right[0, column]).max() / scale
            when += ", before any wave arrives" if change <= allowed[sample] else ", in the wave"
        name = f"the force in contact {column + 1}" if quantity == FORCE else f"the {quantity}"
        return f"departs from its scheme {when}: {name} is {one} {unit}, by its scheme {other} {unit}"
    return ""


def _notes(motions: Motions, engine: str) -> Iterator[str]:
    """Notes on parts of the budget that were not measured."""
    case = motions.case
    if motions.why_unknown:
        yield motions.why_unknown
        return
    if is_at_rest(motions.exact.force_N):
        yield AT_REST_NOTE
    if motions.straight:
        if not motions.exact_to_end.sampling_known:
            yield "sampling not measured: too many samples"
        if load_engine(engine).scheme == EXACT or motions.known < case.scene.samples:
            yield exactness_note(motions)
        return
    yield f"truncation extrapolated from half and a quarter of the step (order of convergence {motions.order:.2g})"
    yield f"rounding is included in model: at most {motions.rounding_bound[motions.known - 1]:.1g} of the force"
    yield "sampling not measured"
    if motions.known < case.scene.samples:
        end = case.sample_times_s[motions.known - 1]
        yield f"measured until t = {end:g} s; later rounding alone separates two runs"


def exactness_note(motions: Motions) -> str:
    """Sentence on the error of the exact motion of a straight chain."""
    samples, times = motions.known, motions.case.sample_times_s
    if samples == len(times):
        return f"exact to {motions.exact_error[-1]:.0e} of the largest change, measured by a run at another tolerance"
    return (
        f"the exact motion is known to {HORIZON:g} of the largest change until t = {times[samples - 1]:g} s, and to"
        f" {motions.exact_error[-1]:.1g} at the end, since the chain amplifies rounding errors; later errors are not"
        " measured"
    )


def _warnings(
    motions: Motions, engine: str, trace: Trace, checks: Iterable[Check], rows: list[dict[str, Any]]
) -> Iterator[str]:
    """Warnings on errors above a tenth, on an exact motion that is lost, and on codes that deviate from the scheme."""
    case, unknown = motions.case, bool(motions.why_unknown)
    if unknown and not motions.straight:
        return
    exact = None if unknown else motions.exact
    if exact is None:
        off_J = energy_error_J(trace.total_energy_J, damped=case.chain.damped, slips=case.chain.slips)
        errors = {FORCE: predicted_error(case, engine), "energy": off_J / motions.scale("energy")}
    else:
        errors = {
            quantity: apart(field_of(trace, quantity), field_of(exact, quantity), motions.scale(quantity)).max(axis=1)
            for quantity in (FORCE, "energy")
        }
    scales = {FORCE: "largest change of force", "energy": "largest kinetic energy"}
    for quantity, error in errors.items():
        limit = tolerance("warning", quantity).limit
        if not (error <= limit).all():
            since = case.sample_times_s[int(np.argmax(~(error <= limit)))]
            most = f"error of the {quantity} up to {error.max():.2g} of the {scales[quantity]}"
            row = next((row for row in rows if row["quantity"] == quantity), None)
            cause = max(PARTS[1:], key=lambda part: abs(row[part])) if row else "truncation"
            yield f"{most}, above {limit:g} from t = {since:g} s; cause: {CAUSES[cause]}"
    scheme = load_engine(engine).scheme
    if scheme == EXACT and exact is not None and motions.exact_error[-1] > HORIZON:
        yield exactness_note(motions)
    force = next(check for check in checks if check.quantity == f"{MODEL}: {FORCE}")
    if force.verdict == FAIL and scheme != EXACT:
        yield (
            f"forces differ from velocity Verlet at the same step by up to {force.value:.2g} of the largest change,"
            f" {force.where}; rounding explains {force.limit:.1g}: the engine did not run the scene as written"
        )


def budget_lines(heading: str, runs: Mapping[str, EndedRun]) -> Iterator[str]:
    """Error budgets of runs for a terminal, by quantity: of forces, energy, momentum and peaks; notes and warnings.

    Rows with missing parts, in records of other versions, are left out. ``heading`` is that of the names of the runs.
    """
    rows = [
        (name, row) for name, run in runs.items() for row in run.record.error_budget or () if row.keys() >= {*PARTS}
    ]
    quantities = [*dict.fromkeys(row["quantity"] for _, row in rows)]
    shown = {name for name in quantities if name in (FORCE, *FIELDS)} | {*of_kind(quantities, "peak")}
    rows = [
        (name, row) for quantity in quantities if quantity in shown for name, row in rows if row["quantity"] == quantity
    ]
    parts = [*PARTS, *([ELEMENTS] if any(ELEMENTS in row for _, row in rows) else [])]
    cells = [(name, row["quantity"], *(f"{row[part]:.1e}" for part in parts if part in row)) for name, row in rows]
    if cells:
        yield f"\nerror budget: {BUDGET_WORDS}"
        yield from text_table([(heading, "quantity", *parts), *cells], right=range(2, 8))
    for name, run in runs.items():
        lines = [run.record.error_note, *(f"warning: {warning}" for warning in run.record.warnings or ())]
        yield from (f"{name:<9} {line}" for line in lines if line)
