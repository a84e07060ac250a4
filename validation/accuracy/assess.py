"""Assessment of a run: gauge signals, error budget, accuracy reached, and warnings."""

import math

from drivers.chain.case import Case
from drivers.limits.stable_step import predicted_limit
from drivers.run.run_folder import EndedRun
from postproc.read.sensors import signals_csv
from validation.accuracy.budget import ERROR, kept_budget


def assess(ended: EndedRun, case: Case) -> EndedRun:
    """Measure the errors of a run and write its gauge signals and the record, unless both are complete already.

    A run reused for another scene of the same physics is assessed again. A failed run is returned unchanged.
    """
    if not ended.done or (ended.record.error_budget is not None and ended.has_sensors):
        return ended
    budget, accuracy = kept_budget(case, ended), None
    if plan := case.plan:
        measured = {check.quantity: check.value for check in budget.checks}
        accuracy = {
            name: {"asked": share, "predicted": plan.predicted[name], "measured": measured[f"{ERROR}: {name}"]}
            for name, share in plan.asked.items()
        }
    limit = predicted_limit(case.chain, float(case.sample_times_s[-1]))
    return ended.with_sensors(
        signals_csv(case.layout, ended.trace),
        error_budget=budget.rows,
        error_note=budget.note,
        exact_to=budget.exact_to,
        exact_until_s=budget.exact_until_s,
        warnings=budget.warnings,
        step_limit_s=limit if math.isfinite(limit) else None,
        accuracy=accuracy,
    )
