"""Assessment of a run: gauge signals, error budget, accuracy reached, and warnings."""

from drivers.chain.case import Case
from drivers.run.run_folder import EndedRun
from postproc.read.sensors import signals_csv
from validation.accuracy.budget import ERROR, kept_budget


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
    copied = {
        "error_budget": budget.rows,
        "error_note": budget.note,
        "exact_to": budget.exact_to,
        "exact_until_s": budget.exact_until_s,
        "warnings": budget.warnings,
        "accuracy": accuracy,
    }
    if ended.has_sensors and all(getattr(ended.record, name) == value for name, value in copied.items()):
        return ended
    return ended.with_sensors(signals_csv(case.layout, ended.trace), **copied)
