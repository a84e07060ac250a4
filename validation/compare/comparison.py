"""Compares runs with the two yardsticks: the same scheme at the same step, and the exact reference.

Against ``verlet`` at the same step a run shows its modelling error, which should be rounding; against
``reference`` it shows what the user pays for the time step.
"""

import numpy as np

from drivers.base.tolerances import Tolerance, tolerance
from drivers.chain.case import Case
from drivers.chain.trace import Trace
from drivers.run.finished import EndedRun
from drivers.run.guard import energy_error
from postproc.read.observables import observe, of_kind
from postproc.read.residual import REFERENCE
from validation.accuracy.baseline import (
    HORIZON,
    ROUNDING_MARGIN,
    ROUNDING_REASON,
    VERLET,
    Baseline,
    baseline_of,
    shipped_name,
)
from validation.compare.deviation import Deviation, deviation, motion_deviation
from validation.compare.verdict import FAIL, NOT_RUN, Verdict, judged

NOT_INSTALLED, REFUSED = "not installed", "refused"  # why an engine has no run, and need not have one


def compare_case(case: Case, runs: dict[str, EndedRun], absent: dict[str, str]) -> list[Verdict]:
    """Verdicts on all finished runs of a case, by engine, and on those that are absent, by why.

    What is not installed, or refused the case by name, counts as not run, all else is a failure.
    """
    verdicts = []
    for engine, why in absent.items():
        verdict = NOT_RUN if why.startswith((NOT_INSTALLED, REFUSED)) else FAIL
        nan = float("nan")
        verdicts.append(Verdict(case.scene.name, engine, "run", nan, nan, "a run has to be done", why, verdict))
    for engine, run in runs.items():
        verdicts += _force_verdicts(case, engine, run, runs)
        verdicts += _observable_verdicts(case, engine, run, runs)
        verdicts += _balance_verdicts(case, engine, run)
    return verdicts


def _force_verdicts(case: Case, engine: str, run: EndedRun, runs: dict[str, EndedRun]) -> list[Verdict]:
    verdicts = []
    if VERLET in runs and engine not in (VERLET, REFERENCE):
        baseline, own = baseline_of(case), baseline_of(case, engine)
        another_law = own.law != baseline.law and not own.unknown  # of friction: the same scheme with the engine's
        verlet, limit, samples = own.plain if another_law else runs[VERLET].trace, baseline.allowed, baseline.samples
        found = deviation(run.trace, verlet, samples)
        until = ""
        if samples < case.scene.samples:
            until = f"; judged until {run.trace.time_s[samples] * 1e6:g} µs, where rounding alone passes {HORIZON:g}"
        verdicts.append(_judge(case, engine, "force against verlet", found, limit, until))
        verdicts.append(_motion_verdict(baseline, engine, run.trace, verlet))
    if REFERENCE in runs and engine != REFERENCE:
        found = deviation(run.trace, runs[REFERENCE].trace)
        limit = tolerance("truncation", "force", shipped_name(case))
        verdicts.append(_judge(case, engine, "force against reference", found, limit))
    others = [name for name in runs if name != engine]
    if others and not {VERLET, REFERENCE} & set(runs):  # a bore of flat sides: only the codes have it
        found = deviation(run.trace, runs[others[0]].trace)
        verdicts.append(_judge(case, engine, f"force against {others[0]}", found, tolerance("model", "sides")))
    return verdicts


def _motion_verdict(baseline: Baseline, engine: str, trace: Trace, verlet: Trace) -> Verdict:
    """Kinetic energy and momentum: recorded velocities that are off change no force.

    Where the forces are allowed more, by rounding or by a sphere for a face, so are they.
    """
    chain, samples = baseline.case.chain, baseline.samples
    found = motion_deviation(chain, trace, verlet, samples)
    limit = max(tolerance("model", "motion"), baseline.allowed, key=lambda each: each.limit)
    if found.share > limit.limit:
        rounded = ROUNDING_MARGIN * motion_deviation(chain, baseline.rounded, baseline.plain, samples).share
        limit = max(limit, Tolerance(rounded, ROUNDING_REASON), key=lambda each: each.limit)
    return judged(baseline.case.scene.name, engine, "motion against verlet", found.share, limit, found.place)


def _observable_verdicts(case: Case, engine: str, run: EndedRun, runs: dict[str, EndedRun]) -> list[Verdict]:
    """The worst relative error of peaks and of speeds against the reference's."""
    if REFERENCE not in runs or engine == REFERENCE:
        return []
    values = observe(run.layout, run.trace)
    exact = observe(runs[REFERENCE].layout, runs[REFERENCE].trace)
    verdicts = []
    for label, kind in (("peak of a gauge", "peak"), ("speed between gauges", "speed")):
        errors = {
            name: abs(values[name] / exact[name] - 1)
            for name in of_kind(exact, kind)
            if np.isfinite(exact[name]) and exact[name]
        }
        if errors:
            worst = max(errors, key=lambda name: np.inf if np.isnan(errors[name]) else errors[name])
            limit = tolerance("truncation", kind, shipped_name(case))
            verdicts.append(judged(case.scene.name, engine, label, errors[worst], limit, worst))
    return verdicts


def _balance_verdicts(case: Case, engine: str, run: EndedRun) -> list[Verdict]:
    """Energy and impulse; the latter no finer than the samples of the wall's force allow."""
    name, values = shipped_name(case), observe(run.layout, run.trace)
    energy = float(energy_error(case.chain, run.trace).max())
    impulse, sampling = values["impulse_imbalance_share"], values["impulse_sampling_share"]
    limit = tolerance("impulse", "balance", name)
    if sampling > limit.limit:
        limit = Tolerance(sampling, "what the wall's impulse changes when every other sample is left out")
    if case.plan and min(case.plan.asked.values()) > limit.limit:
        limit = Tolerance(min(case.plan.asked.values()), "the accuracy that the scene asks for")
    drift = tolerance("energy", "drift", name)
    return [
        judged(case.scene.name, engine, "energy drift", energy, drift, "share of what is put in"),
        judged(case.scene.name, engine, "impulse balance", impulse, limit, "share of momentum"),
    ]


def _judge(case: Case, engine: str, quantity: str, found: Deviation, limit: Tolerance, remark: str = "") -> Verdict:
    return judged(case.scene.name, engine, quantity, found.share, limit, f"{found.place}{remark}")
