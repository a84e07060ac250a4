"""Checks of the results of an engine: scenes, order of convergence, restitution, blow-up, sabotaged decks."""

from collections.abc import Iterator
from math import log2

import numpy as np

from drivers.base.errors import RunError
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.trace import Trace, until
from drivers.engines import VERLET
from drivers.limits.refusal import FORCE, inability
from drivers.limits.stable_step import predicted_limit
from drivers.limits.trial import first_failure_s
from validation.accuracy.baseline import Baseline, baseline_of
from validation.accuracy.exact_motion import exact_motion_of
from validation.accuracy.plan import planned_case
from validation.accuracy.prediction import predict
from validation.compare.comparison import motion_verdict
from validation.compare.departure import deviation
from validation.kit.candidate import Candidate, Measured, NotRunError, Variant, case_with, within

STABLE_SHARE = 0.98  # of the predicted limit: a step at which a run has to be stable
PRECOMPRESSION = ("chain.precompression=20 N", "run.duration=1 ms")  # closed contacts make the limit sharp
COLLISION = ("gravity=", "tube=", "run.duration=0.4 ms", "run.time_step=0.02 us")
IMPACTS = {"two beads": (*COLLISION, "chain.count=1", "wall="), "a bead on the wall": (*COLLISION, "chain.count=0")}
RESTITUTIONS = (0.3, 0.8, 0.99)
STEPS = (5, 10, 20)  # steps per sample for the order of convergence


def case_of_variant(variant: Variant) -> Case:
    """Planned case of a variant."""
    return planned_case(variant.scene, *variant.set) if variant.scene else case_with(*variant.set)


def scene(candidate: Candidate, variant: Variant) -> Iterator[Measured]:
    """Forces, energy and momentum agree with the engine's scheme at the same step and with the exact motion."""
    case = case_of_variant(variant)
    trace, name = candidate.run(case), candidate.engine.name
    baseline = baseline_of(case, name)
    error = ""
    if candidate.steps and not baseline.why_unknown:
        exact, predicted = baseline.exact, predict(baseline, name)
        off = deviation(until(trace, len(exact.time_s)), exact)
        error = f"; error {off.share:.1e} against the exact motion"
        limit, words = predicted.tolerance(FORCE, tolerance("truncation", "force"))
        truncation = Measured(off.share, limit.limit, f"error against the exact motion, {off.place}{words}")
        if truncation.share > 1:
            yield truncation
    allowed, samples = baseline.allowed.limit, baseline.samples
    if not candidate.steps:
        off = deviation(until(trace, len(baseline.exact.time_s)), baseline.exact, samples)
        yield Measured(off.share, allowed, f"error against the exact motion, {off.place}")
        return
    off = deviation(trace, baseline.plain, samples)
    yield Measured(off.share, allowed, f"force against {VERLET}, {off.place}{error}")
    motion = motion_verdict(baseline, name, trace, baseline.plain)
    yield Measured(motion.value, motion.limit, f"{motion.quantity}, {motion.where}{error}")


def order(candidate: Candidate) -> Iterator[Measured]:
    """Errors converge with the order of the scheme: two, or one with damping."""
    if not candidate.steps:
        raise NotRunError("the engine has no time step")
    for name, settings in (("elastic", ()), ("damped", ("contact.restitution=0.9",))):
        case = case_with(*settings)
        if inability(case, candidate.engine.name):
            continue
        exact = exact_motion_of(case, finer=False).trace
        errors = [deviation(candidate.run(case.at(steps)), exact).share for steps in STEPS]
        found, expected = log2(errors[1] / errors[2]), Baseline(case, candidate.engine.shear).order
        at = ", ".join(f"{error:.1e}" for error in errors)
        steps = ", ".join(map(str, STEPS))
        errors_at = f"{name}: errors {at} at {steps} steps per sample"
        words = f"deviation from order {expected:g} of convergence, measured {found:.3f} ({errors_at})"
        yield within("order", abs(found - expected), words)


def restitution(candidate: Candidate) -> Iterator[Measured]:
    """Impacts have the restitution of the scene and no attraction."""
    if "damping" not in candidate.engine.models:
        raise NotRunError("the engine does not model damping")
    ran = False
    for name, settings in IMPACTS.items():
        for wanted in RESTITUTIONS:
            case = case_with(*settings, f"contact.restitution={wanted}")
            if inability(case, candidate.engine.name):
                continue
            trace, ran = candidate.run(case), True
            if trace.force_N.min() < -1e-12 * trace.force_N.max():
                raise RunError(f"{name}: contacts pull by {-trace.force_N.min():.2g} N")
            error = abs(bounced(case, trace) / wanted - 1) / (1 - wanted)
            quantity = "restitution" if candidate.steps else "restitution_exact"
            yield within(quantity, error, f"relative error over the loss 1 - e, {name}, e = {wanted}")
    if not ran:
        raise NotRunError("the engine refuses all impacts")


def bounced(case: Case, trace: Trace) -> float:
    """Restitution of an impact, from the kinetic energy and momentum of a run."""
    if trace.force_N[-1].any():
        raise RunError("the impact is not over")
    apart = trace.kinetic_energy_J
    if case.chain.wall is None:
        apart = apart - trace.momentum_N_s**2 / (2 * case.chain.mass_kg.sum())
    return float(np.sqrt(apart[-1] / apart[0]))


def blow_up(candidate: Candidate) -> Iterator[Measured]:
    """Below the predicted stability limit a run is stable; at the step where Verlet blows up the run fails."""
    if not candidate.steps:
        raise NotRunError("the engine has no time step")
    case = case_with(*PRECOMPRESSION)
    candidate.admit(case)
    predicted_s = predicted_limit(case.chain, float(case.sample_times_s[-1]))
    candidate.run(case.sampled_at_every(STABLE_SHARE * predicted_s))
    fails_s = first_failure_s(case, predicted_s)
    assert fails_s is not None
    try:
        candidate.run(case.sampled_at_every(fails_s))
    except RunError as error:
        if not str(error).startswith("unstable at t = "):
            raise RunError(f"at {fails_s:.3g} s, where {VERLET} blows up: {error}") from error
        stable = f"stable at a step of {STABLE_SHARE * predicted_s:.3g} s, below the predicted limit"
        yield Measured(0, 0, f"{stable}; failed at {fails_s:.3g} s: {str(error).partition(';')[0]}")
    else:
        raise RunError(f"at {fails_s:.3g} s, where {VERLET} blows up, the run did not fail")


def sabotage(candidate: Candidate) -> Iterator[Measured]:
    """The output of a deck with one changed number differs from that of the scene by more than the tolerance."""
    case = candidate.base
    baseline = baseline_of(case, candidate.engine.name)
    right = baseline.plain if candidate.steps else baseline.exact
    deviations = dict[str, float]()
    for name, other in candidate.changed().items():
        try:
            trace = candidate.run_deck(case, candidate.engine.render(other))
        except RunError:
            deviations[name] = np.inf
        else:
            deviations[name] = deviation(trace, right, baseline.samples).share
    least = min(deviations, key=lambda name: deviations[name])
    limit = baseline.allowed.limit
    if unseen := [name for name, share in deviations.items() if not share > limit]:
        raise RunError(f"another {', another '.join(unseen)} in the deck changes the forces by no more than {limit:g}")
    effect = (
        f"the least of {len(deviations)} wrong decks, with another {least}, changes forces by {deviations[least]:.1e}"
    )
    words = f"tolerance over effect: {effect}; tolerance {limit:.1e}"
    yield Measured(limit / deviations[least], 1.0, words)
