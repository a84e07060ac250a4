"""Checks of what an engine computes: scenes, order of convergence, restitution, blow-up, sabotage of the deck."""

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
from validation.accuracy.plan import planned_case
from validation.accuracy.prediction import predict
from validation.accuracy.schemes import truth_of
from validation.compare.comparison import motion_verdict
from validation.compare.departure import deviation
from validation.kit.candidate import Candidate, Measured, NotRunError, Variant, case_with, within

BELOW = 0.98  # share of the predicted limit at which a run has to be stable
PRESSED = ("chain.precompression=20 N", "run.duration=1 ms")  # stiff all the time: the limit is sharp
ALONE = ("gravity=", "tube=", "run.duration=0.4 ms", "run.time_step=0.02 us")
IMPACTS = {"two beads": (*ALONE, "chain.count=1", "wall="), "a bead on the wall": (*ALONE, "chain.count=0")}
RESTITUTIONS = (0.3, 0.8, 0.99)
STEPS = (5, 10, 20)  # a sample, from which the order of convergence is taken


def case_of_variant(variant: Variant) -> Case:
    """The case of a variant."""
    return planned_case(variant.scene, *variant.set) if variant.scene else case_with(*variant.set)


def scene(candidate: Candidate, variant: Variant) -> Iterator[Measured]:
    """Forces, energy and momentum are those of the engine's scheme at the same step, and near the exact ones."""
    case = case_of_variant(variant)
    trace, name = candidate.run(case), candidate.engine.name
    baseline = baseline_of(case, name)
    beside = ""
    if candidate.steps and not baseline.unknown:
        exact, predicted = baseline.exact, predict(baseline, name)
        off = deviation(until(trace, len(exact.time_s)), exact)
        beside = f"; {off.share:.1e} from the exact motion"
        limit, words = predicted.tolerance(FORCE, tolerance("truncation", "force"))
        truncation = Measured(off.share, limit.limit, f"against the exact motion, {off.place}{words}")
        if truncation.share > 1:
            yield truncation
    allowed, samples = baseline.allowed.limit, baseline.samples
    if not candidate.steps:
        off = deviation(until(trace, len(baseline.exact.time_s)), baseline.exact, samples)
        yield Measured(off.share, allowed, f"against the exact motion, {off.place}")
        return
    off = deviation(trace, baseline.plain, samples)
    yield Measured(off.share, allowed, f"against {VERLET} at the same step, {off.place}{beside}")
    motion = motion_verdict(baseline, name, trace, baseline.plain)
    yield Measured(motion.value, motion.limit, f"{motion.quantity}, {motion.where}{beside}")


def order(candidate: Candidate) -> Iterator[Measured]:
    """Errors shrink with the time step by the order of the scheme: two, and one of damped contacts."""
    if not candidate.steps:
        raise NotRunError("its time steps are its own")
    for name, settings in (("elastic", ()), ("damped", ("contact.restitution=0.9",))):
        case = case_with(*settings)
        if inability(case, candidate.engine.name):
            continue
        exact = truth_of(case, finer=False).trace
        errors = [deviation(candidate.run(case.at(steps)), exact).share for steps in STEPS]
        found, expected = log2(errors[1] / errors[2]), Baseline(case, candidate.engine.shear).order
        words = f"off order {expected:g} ({name}: errors {', '.join(f'{error:.1e}' for error in errors)})"
        yield within("order", abs(found - expected), words)


def restitution(candidate: Candidate) -> Iterator[Measured]:
    """Impacts give back what the scene asks for, gain no energy and never pull."""
    if "damping" not in candidate.engine.models:
        raise NotRunError("it does not model damping")
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
            yield within(quantity, error, f"of what is lost, off in {name} at {wanted}")
    if not ran:
        raise NotRunError("it refuses all of these")


def bounced(case: Case, trace: Trace) -> float:
    """Relative speed after over that before, from energy and momentum, which every run keeps."""
    if trace.force_N[-1].any():
        raise RunError("the impact is not over")
    apart = trace.kinetic_energy_J
    if case.chain.wall is None:
        apart = apart - trace.momentum_N_s**2 / (2 * case.chain.mass_kg.sum())
    return float(np.sqrt(apart[-1] / apart[0]))


def blow_up(candidate: Candidate) -> Iterator[Measured]:
    """Below the predicted limit of the time step a run is stable; at the step where Verlet blows up, so is it said."""
    if not candidate.steps:
        raise NotRunError("its time steps are its own")
    case = case_with(*PRESSED)
    candidate.admit(case)
    predicted_s = predicted_limit(case.chain, float(case.sample_times_s[-1]))
    candidate.run(case.sampled_at_every(BELOW * predicted_s))
    fails_s = first_failure_s(case, predicted_s)
    assert fails_s is not None
    try:
        candidate.run(case.sampled_at_every(fails_s))
    except RunError as error:
        if not str(error).startswith("unstable at t = "):
            raise RunError(f"at {fails_s:.3g} s, where {VERLET} blows up: {error}") from error
        stable = f"stable at {BELOW * predicted_s:.3g} s, below the predicted limit"
        yield Measured(0, 0, f"{stable}; at {fails_s:.3g} s {str(error).partition(';')[0]}")
    else:
        raise RunError(f"at {fails_s:.3g} s, where {VERLET} blows up, it is done")


def sabotage(candidate: Candidate) -> Iterator[Measured]:
    """The output of a deck with any one number changed is told from that of the scene."""
    case = candidate.base
    baseline = baseline_of(case, candidate.engine.name)
    right = baseline.plain if candidate.steps else baseline.exact
    told = dict[str, float]()
    for name, other in candidate.changed().items():
        try:
            trace = candidate.run_deck(case, candidate.engine.render(other))
        except RunError:
            told[name] = np.inf
        else:
            told[name] = deviation(trace, right, baseline.samples).share
    least = min(told, key=lambda name: told[name])
    red = baseline.allowed.limit
    if unseen := [name for name, share in told.items() if not share > red]:
        raise RunError(f"another {', another '.join(unseen)} in the deck changes its forces by no more than {red:g}")
    words = f"of the difference that {least} makes is allowed, the least of {len(told)} changes"
    yield Measured(red / told[least], 1.0, words)
