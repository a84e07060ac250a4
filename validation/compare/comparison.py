"""Compares runs with the two yardsticks: the same scheme at the same step, and the exact reference.

Against ``verlet`` at the same step a run shows its modelling error, which should be rounding; against
``reference`` it shows what the user pays for the time step.
"""

import numpy as np

from drivers.base import paths
from drivers.base.tolerances import Tolerance, tolerance
from drivers.chain.case import Case
from drivers.chain.trace import Trace
from drivers.engines import load_engine
from drivers.run.finished import EndedRun
from drivers.run.guard import energy_error
from drivers.scene.read_scene import read_scene
from postproc.read.observables import observe, of_kind
from postproc.read.residual import share_of_largest
from validation.accuracy.deviation import Deviation, deviation, motion_deviation
from validation.accuracy.rounding import HORIZON, ROUNDING_MARGIN, comparable, rounding_error, verlet_in_heights
from validation.accuracy.tube_budget import model_quantity, sideways_rounding, tube_verlet_of, why_unmeasured
from validation.compare.verdict import FAIL, NOT_RUN, Verdict, judged

NOT_INSTALLED, REFUSED = "not installed", "refused"  # why an engine has no run, and need not have one
ROUNDING_REASON = (
    f"{ROUNDING_MARGIN:g} times what rounding absolute coordinates does to this very scene, measured in-repo"
)


def compare_case(case: Case, runs: dict[str, EndedRun], absent: dict[str, str]) -> list[Verdict]:
    """Verdicts on all runs of a case.

    Args:
        case: the case that was run.
        runs: finished runs by engine.
        absent: by engine, why there is no finished run; what is not installed, or refused the case by name, counts as
            not run, all else is a failure.
    """
    verdicts = []
    for engine, why in absent.items():
        verdict = NOT_RUN if why.startswith((NOT_INSTALLED, REFUSED)) else FAIL
        verdicts.append(
            Verdict(case.scene.name, engine, "run", float("nan"), float("nan"), "a run has to be done", why, verdict)
        )
    for engine, run in runs.items():
        verdicts += _force_verdicts(case, engine, run, runs)
        verdicts += _observable_verdicts(case, engine, run, runs)
        verdicts += _balance_verdicts(case, engine, run)
    return verdicts


def _force_verdicts(case: Case, engine: str, run: EndedRun, runs: dict[str, EndedRun]) -> list[Verdict]:
    verdicts = []
    if "verlet" in runs and engine not in ("verlet", "reference"):
        verlet = _same_scheme(case, engine, runs["verlet"].trace)
        limit, samples = model_tolerance(case, verlet)
        found = deviation(run.trace, verlet, samples)
        until = ""
        if samples < case.scene.samples:
            until = f"; judged until {run.trace.time_s[samples] * 1e6:g} µs, where rounding alone passes {HORIZON:g}"
        verdicts.append(_judge(case, engine, "force against verlet", found, limit, until))
        verdicts.append(_motion_verdict(case, engine, run.trace, verlet, limit, samples))
    if "reference" in runs and engine != "reference":
        found = deviation(run.trace, runs["reference"].trace)
        limit = tolerance("truncation", "force", shipped_name(case))
        verdicts.append(_judge(case, engine, "force against reference", found, limit))
    others = [name for name in runs if name != engine]
    if others and not {"verlet", "reference"} & set(runs):  # a bore of flat sides: only the codes have it
        found = deviation(run.trace, runs[others[0]].trace)
        verdicts.append(_judge(case, engine, f"force against {others[0]}", found, tolerance("model", "sides")))
    return verdicts


def _motion_verdict(case: Case, engine: str, trace: Trace, verlet: Trace, forces: Tolerance, samples: int) -> Verdict:
    """Kinetic energy and momentum: recorded velocities that are off change no force.

    Where the forces are allowed more, by rounding or by a sphere for a face, so are they.
    """
    found = motion_deviation(case.chain, trace, verlet, samples)
    stated = tolerance("model", "motion")
    limit = stated if forces.limit <= stated.limit else forces
    if found.share > limit.limit and case.chain.lateral is None:
        rounded = motion_deviation(case.chain, verlet_in_heights(case), verlet, samples).share
        if ROUNDING_MARGIN * rounded > limit.limit:
            limit = Tolerance(ROUNDING_MARGIN * rounded, ROUNDING_REASON)
    where = f"{found.quantity} at {found.time_s * 1e6:g} µs"
    return judged(case.scene.name, engine, "motion against verlet", found.share, limit, where)


def _same_scheme(case: Case, engine: str, verlet: Trace) -> Trace:
    """The run of engine ``verlet``, or where friction's law is another the same with that of the engine in question."""
    law = load_engine(engine).shear
    if case.chain.lateral is None or law == load_engine("verlet").shear or why_unmeasured(case):
        return verlet
    return tube_verlet_of(case, law)


def model_tolerance(case: Case, verlet: Trace) -> tuple[Tolerance, int]:
    """The tolerance of the modelling error, and how many samples it is good for.

    It is wider than stated only where rounding by itself is measured to exceed it, and ends where that grows
    beyond ``HORIZON``: a chain that bounces on is chaotic.
    """
    stated = tolerance("model", model_quantity(case), shipped_name(case))
    rounding = rounding_error if case.chain.lateral is None else sideways_rounding
    allowed, samples = comparable(share_of_largest(rounding(case), verlet))
    if allowed <= stated.limit:
        return stated, samples
    return Tolerance(allowed, ROUNDING_REASON), samples


def shipped_name(case: Case) -> str | None:
    """The scene's name if it is one of ``inputs/scenes`` just as shipped: only then do that scene's tolerances hold."""
    path = paths.SCENES / f"{case.scene.name}.toml"
    return case.scene.name if path.is_file() and read_scene(path).model_dump() == case.scene.model_dump() else None


def _observable_verdicts(case: Case, engine: str, run: EndedRun, runs: dict[str, EndedRun]) -> list[Verdict]:
    """The worst relative error of peaks and of speeds against the reference's."""
    if "reference" not in runs or engine == "reference":
        return []
    values = observe(run.layout, run.trace)
    exact = observe(runs["reference"].layout, runs["reference"].trace)
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
    where = f"contact {found.contact} at {found.time_s * 1e6:g} µs{remark}"
    return judged(case.scene.name, engine, quantity, found.share, limit, where)
