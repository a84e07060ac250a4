"""Error budget of a run: one table of the parts of its errors, and the two judgements on it.

Values of a quantity: Q of the engine's run, Q_h of its own scheme at the same step (velocity Verlet in absolute
heights), Q_v of velocity Verlet in overlaps, Q_e exact at the same samples, Q_t true (exact, from finer samples, with
all elements of the scene). The parts of the error add up to the whole Q - Q_t:

* model = Q - Q_h: rounding in another order of addition, unless something is wrong (``drivers.run.scheme``);
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

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from math import isnan
from typing import Any

import numpy as np

from drivers.base.cache import load, store
from drivers.base.terminal import text_table
from drivers.base.tolerances import Tolerance, tolerance
from drivers.chain.case import ALL_DIGITS, Case
from drivers.chain.trace import FORCE, Trace, is_at_rest, until, with_work
from drivers.engines import EXACT, load_engine
from drivers.run.run_folder import FORCES, EndedRun
from drivers.run.scheme import COMPARED, ROUNDING_MARGIN, field_of, judged_until, known_of, largest_difference
from postproc.read.observables import describe, of_kind, scale_of
from postproc.read.signals import signals_csv
from validation.accuracy.motions import HORIZON, Motions, errors_of, motions_of, quantities
from validation.checks import FAIL, Check, judged, outcome, short

AT_REST_NOTE = "nothing moves: errors are relative to the largest force"
PARTS = ("whole", "model", "rounding", "truncation", "sampling")
ELEMENTS = "elements"
BUDGET_WORDS = "relative errors; model, rounding, truncation (time step) and sampling add up to the whole"
MODEL, ERROR = "model", "error"  # judgements: the right computation, accurate enough
CAUSES = {
    "model": "the run is not that of its scheme",
    "rounding": "rounding of heights far from 0",
    "truncation": "the time step",
    "sampling": "the interval between samples",
}
# general ceilings of quantities, and of observables by the plural of their kind
CEILINGS = {
    FORCE: ("truncation", FORCE),
    "energy": ("energy", "drift"),
    "peaks": ("truncation", "peak"),
    "speeds": ("truncation", "speed"),
}


@dataclass(frozen=True)
class Budget:
    """Errors of a run and the judgements on them.

    Attributes:
        error_budget: quantity, its parts as in ``PARTS``, and ``where`` for forces, energy and momentum; empty if the
            exact motion is not known.
        checks: the two judgements.
        error_note: parts that were not measured, with the reason.
        warnings: reasons why the run is of little use; most runs have none.
        exact_to: error of the exact motion until ``exact_until_s``, divided by the largest change of force; None for
            three-dimensional chains.
    """

    error_budget: list[dict[str, Any]]
    checks: list[Check]
    error_note: str
    warnings: list[str]
    exact_to: float | None
    exact_until_s: float | None


def kept_budget(case: Case, run: EndedRun, limit_s: float | None = None) -> Budget:
    """Budget of a finished run, from the cache or computed and stored there; checks have the scene's name.

    ``limit_s`` is the time limit of the exact motion. A budget without the exact motion is not stored.
    """
    record, engine = run.record, load_engine(run.record.engine)
    scenes = [variant.scene.model_dump(mode="json") for variant in (case, case.full) if variant]
    depends_on = ["budget", scenes, engine.name, engine.scheme, engine.shear, record.build_sha256, record.files[FORCES]]
    stored = load(depends_on)
    if stored is None:
        stored = asdict(budget_of(case, engine.name, run.trace, limit_s))
        if not motions_of(case, engine.name, limit_s).why_unknown:
            store(depends_on, stored)
    checks = [Check(**check | {"scene": case.scene.name}) for check in stored["checks"]]
    return Budget(**stored | {"checks": checks})


def budget_of(case: Case, engine: str, trace: Trace, limit_s: float | None = None) -> Budget:
    """Budget of a run of a case on an engine, from its trace at all samples of the case."""
    motions = motions_of(case, engine, limit_s)
    with np.errstate(over="ignore", invalid="ignore"):  # too large a step blows up
        rows, missing = _rows(motions, engine, trace)
        checks = [*_model_checks(motions, engine, trace), *_error_checks(motions, engine, trace, rows)]
        known = not motions.why_unknown and motions.case.chain.straight
        samples = motions.known if known else 0
        return Budget(
            error_budget=rows,
            checks=checks,
            error_note="; ".join([*_notes(motions, engine), *missing]),
            warnings=[*_warnings(motions, engine, trace, checks, rows)],
            exact_to=float(motions.exact_to_end.error[samples - 1]) if known else None,
            exact_until_s=float(case.sample_times_s[samples - 1]) if known else None,
        )


def _rows(motions: Motions, engine: str, trace: Trace) -> tuple[list[dict[str, Any]], list[str]]:
    """Parts of the error of each quantity; and a note on observables missing in the run."""
    if motions.why_unknown:
        return [], []
    exact, full, scheme = motions.exact, motions.full, motions.scheme_of(engine)
    samples = min(len(part.time_s) for part in (exact, full.exact if full else exact))
    apart = motions.case.chain.straight and load_engine(engine).scheme != EXACT  # else rounding is in model, or nil
    stages = [until(part, samples) for part in (trace, scheme, motions.scheme.plain if apart else scheme, exact)]
    stages += [stages[-1], *([until(full.exact, samples)] if full else [])]

    rows = []
    for quantity in known_of(trace):
        scale = (full or motions).scale(quantity)
        _, place, where = largest_difference(quantity, trace, stages[-1], scale)
        rows.append(_row(quantity, [float(field_of(stage, quantity)[place]) / scale for stage in stages], where))

    observed = [quantities(motions.case, stage) for stage in stages[:3]] + motions.values
    observed += [full.values[1]] if full else []
    scales = {name: scale_of(name, observed[-1]) for name in observed[-1] if all(name in values for values in observed)}
    rows += [_row(name, [values[name] / scale for values in observed]) for name, scale in scales.items() if scale]
    missing = [name for name, true in observed[-1].items() if true and name not in observed[0]]
    return rows, [f"missing in the run, present in the exact motion: {', '.join(missing)}"] if missing else []


def _row(quantity: str, shares: list[float], where: str = "") -> dict[str, Any]:
    """Signed parts of the error of a quantity, from Q, Q_h, Q_v, Q_e, Q_t and with elements left out the full Q_t."""
    parts = [shares[0] - shares[-1], *(first - second for first, second in pairwise(shares))]
    return {"quantity": quantity, **dict(zip((*PARTS, ELEMENTS), parts, strict=False)), "where": where}


def _model_checks(motions: Motions, engine: str, trace: Trace) -> Iterator[Check]:
    """Is it the right computation? Difference from the engine's scheme that is closest to its limit at its sample."""
    if load_engine(engine).scheme == EXACT and motions.why_unknown:
        return
    scheme = motions.scheme
    right = until(scheme.of(engine), scheme.samples)
    trace = with_work(until(trace, scheme.samples), right)
    for quantity in known_of(trace):
        scale, limits = scheme.scales[quantity], scheme.explained(quantity)
        size, (sample, _), where = largest_difference(quantity, trace, right, scale, limits)
        limit, where = scheme.tolerance_at(quantity, sample), where + scheme.until_horizon
        yield judged(motions.case.scene.name, engine, f"{MODEL}: {quantity}", size, limit, where)


def _error_checks(motions: Motions, engine: str, trace: Trace, rows: list[dict[str, Any]]) -> Iterator[Check]:
    """Is it accurate enough? Whole errors against the accuracy of the scene, else against the general ceilings.

    An error is at least that of the exact motion.
    """
    case = motions.case
    if case.plan is not None and not motions.why_unknown:
        truth = (motions.full or motions).exact_to_end
        for name, error in errors_of(case, trace, truth, case.plan.asked).items():
            limit = Tolerance(case.plan.asked[name], "the accuracy that the scene asks for")
            where = "to the end of the run"
            yield judged(case.scene.name, engine, f"{ERROR}: {name}", max(error, truth.error[-1]), limit, where)
        return
    what = "the error of the exact motion" if motions.case.chain.straight else "rounding alone"
    for name, ceiling in CEILINGS.items():
        alike = [row for row in rows if name in (row["quantity"], f"{describe(row['quantity']).kind}s")]
        if not alike:
            continue
        row = max(alike, key=lambda each: np.nan_to_num(abs(each["whole"]), nan=np.inf))
        where = row["where"] or row["quantity"]
        where += judged_until(case, motions.known, f"{what} exceeds {HORIZON:g}")
        yield judged(case.scene.name, engine, f"{ERROR}: {name}", abs(row["whole"]), tolerance(*ceiling), where)


def _notes(motions: Motions, engine: str) -> Iterator[str]:
    """Notes on parts of the budget that were not measured."""
    case = motions.case
    if motions.why_unknown:
        yield motions.why_unknown
        return
    if is_at_rest(motions.exact.force_N):
        yield AT_REST_NOTE
    if motions.case.chain.straight:
        if motions.exact_to_end.factor == 1:
            yield "sampling not measured: too many samples"
        if load_engine(engine).scheme == EXACT or motions.known < case.scene.samples:
            yield exactness_note(motions)
        return
    yield f"truncation extrapolated from half and a quarter of the step (order of convergence {motions.order:.2g})"
    bound = ROUNDING_MARGIN * motions.scheme.rounding[FORCE][motions.known - 1]
    yield f"rounding is included in model: at most {bound:.1g} of the force"
    yield "sampling not measured"


def exactness_note(motions: Motions) -> str:
    """Sentence on the error of the exact motion of a straight chain."""
    error, times, last = motions.exact_to_end.error, motions.case.sample_times_s, motions.known - 1
    known = f"the exact motion is known to {error[last]:.0e} of the largest change"
    lost = f" until t = {times[last]:g} s, to {error[-1]:.1g} at the end: later errors are not measured"
    return known + lost * (motions.known < len(times))


def _warnings(
    motions: Motions, engine: str, trace: Trace, checks: list[Check], rows: list[dict[str, Any]]
) -> Iterator[str]:
    """Warnings on errors beyond the general ceilings, on an exact motion that is lost, and of a changed deck."""
    wrong = any(check.verdict == FAIL and check.quantity.startswith(MODEL) for check in checks)
    for check in checks:
        name = check.quantity.removeprefix(f"{ERROR}: ")
        row = next((row for row in rows if row["quantity"] == name), None)
        if check.verdict == FAIL and row and motions.case.plan is None:
            part = max(PARTS[1:], key=lambda part: abs(row[part]))
            small = "the few digits of the output" if motions.case.digits < ALL_DIGITS else CAUSES["rounding"]
            cause = CAUSES[part] if part != MODEL or wrong else small
            yield f"error of the {name} {check.value:.2g}, above {check.limit:g}: {check.where}; cause: {cause}"
    if load_engine(engine).scheme == EXACT and not motions.why_unknown and motions.exact_to_end.error[-1] > HORIZON:
        yield exactness_note(motions)
    if wrong:
        yield motions.scheme.departure(engine, trace)


def budget_rows(runs: Mapping[str, EndedRun]) -> list[tuple[str, str, dict[str, Any]]]:
    """Quantity, name of the run, and parts of the error of each row of the budgets of runs, by quantity."""
    rows = [(row["quantity"], name, row) for name, run in runs.items() for row in run.record.error_budget or ()]
    order = [*dict.fromkeys(quantity for quantity, *_ in rows)]
    return sorted(rows, key=lambda row: order.index(row[0]))


def budget_lines(heading: str, runs: Mapping[str, EndedRun]) -> Iterator[str]:
    """Error budgets of runs for a terminal, by quantity: of forces, energy, momentum and peaks; notes and warnings.

    ``heading`` is that of the names of the runs.
    """
    rows = budget_rows(runs)
    shown = (*COMPARED, *of_kind([quantity for quantity, *_ in rows], "peak"))
    parts = [part for part in (*PARTS, ELEMENTS) if any(part in row for *_, row in rows)]
    cells = [
        (name, quantity, *(f"{row.get(part, 0.0):.1e}" for part in parts))
        for quantity, name, row in rows
        if quantity in shown
    ]
    if cells:
        yield f"\nerror budget: {BUDGET_WORDS}"
        yield from text_table([(heading, "quantity", *parts), *cells], right=range(2, 8))
    for name, run in runs.items():
        lines = [run.record.error_note, *(f"warning: {warning}" for warning in run.record.warnings or ())]
        yield from (f"{name:<9} {line}" for line in lines if line)


def text_of(checks: Sequence[Check]) -> str:
    """Outcome of checks, error of the force against the exact motion if it was judged, and reason of a missing run."""
    errors = [short(check.value) for check in checks if check.quantity == f"{ERROR}: {FORCE}"]
    return "\n".join([" ".join([outcome(checks), *errors]), *(check.where for check in checks if isnan(check.limit))])


def assess(ended: EndedRun, case: Case, limit_s: float | None = None) -> EndedRun:
    """Measure the errors of a run, and write its gauge signals and the record where they are not up to date.

    The budget is that of the cache, which goes by the sources; the record holds a copy for people. A failed run is
    returned unchanged. ``limit_s`` is the time limit of the exact motion.
    """
    if not ended.done:
        return ended
    budget, accuracy = kept_budget(case, ended, limit_s), None
    if plan := case.plan:
        measured = {check.quantity: check.value for check in budget.checks}
        accuracy = {
            name: {"asked": share, "predicted": plan.predicted[name], "measured": measured.get(f"{ERROR}: {name}")}
            for name, share in plan.asked.items()
        }
    copied = {name: value for name, value in vars(budget).items() if name != "checks"} | {"accuracy": accuracy}
    if ended.has_sensors and all(getattr(ended.record, name) == value for name, value in copied.items()):
        return ended
    return ended.with_sensors(signals_csv(case.layout, ended.trace), **copied)


def missed_accuracy(ended: EndedRun) -> str:
    """Message on the quantities of an assessed run that miss the accuracy of the scene; empty if there are none."""
    return "; ".join(
        f"{name} has an error of {errors['measured']:.3g}, at most {errors['asked']:g} is allowed"
        for name, errors in (ended.record.accuracy or {}).items()
        if (errors["measured"] or 0.0) > (errors["asked"] or 0.0)
    )
