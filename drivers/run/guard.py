"""Guard: checks of a run's output before the run counts as done."""

import re
from collections.abc import Iterator
from math import sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.base.errors import RunError, digits_apart
from drivers.base.processes import STDERR, STDOUT, EndedProcess
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, energy_put_in, furthest_m
from drivers.chain.contact_law import hertz_force
from validation.reference.hertz_chain import hertz_energy
from drivers.chain.drive_work import work_error_J
from drivers.chain.trace import Trace, energy_error_J
from drivers.engines import Engine
from drivers.limits.energy_bounds import share_at_most

REASON_CHARACTERS = 300
UNSTABLE, WRONG_ENERGY = "unstable at t = ", "wrong energy from t = "  # beginnings of messages
OWN_ERRORS = ("ERROR", "Traceback")  # beginnings of lines that lead to the code's own message
ROUNDINGS = 64  # largest deviation of a start in units in the last place of the coordinates
START_TOLERANCE = 1e-9  # of the largest force and speed


def checked_trace(case: Case, engine: Engine, outcome: EndedProcess, folder: Path) -> Trace:
    """Read and check the trace of a process that ended.

    Raises:
        RunError: the run failed; with the partial trace if there is one.
    """
    if outcome.timed_out:
        raise timed_out(outcome.limit_s)
    if outcome.code != 0:
        stdout, stderr = ((folder / name).read_text(errors="replace") for name in (STDOUT, STDERR))
        ending = f"exit code {outcome.code}" if outcome.code > 0 else f"killed by signal {-outcome.code}"
        message = _failed_start(stdout, stderr) or engine.failure_reason(stdout, stderr)
        message = "".join(c if c.isprintable() else " " for c in message)
        before = engine.partial_trace(case, folder)
        blown_up = _blown_up(case, engine, message, before)
        raise RunError("; ".join(filter(None, (blown_up, f"{ending}: {message[:REASON_CHARACTERS]}"))), partial=before)
    try:
        trace = engine.read(case, folder)
    except RunError as error:
        error.partial = engine.partial_trace(case, folder)
        raise
    return checked(case, trace)


def checked(case: Case, trace: Trace) -> Trace:
    """Check a complete trace.

    Raises:
        RunError: it cannot be that of the case.
    """
    reason = unstable(case, trace) or wrong_start(case, trace) or wrong_energy(case, trace)
    reason = reason or not_modelled(case.chain, trace)
    if reason:
        raise RunError(reason, partial=trace)
    return trace


def timed_out(limit_s: float) -> RunError:
    """Error of a run that was ended at its time limit."""
    return RunError(f"killed at the time limit of {limit_s:g} s", status="timeout")


def _failed_start(stdout: str, stderr: str) -> str:
    """Lines of the standard error of a program that failed before any output, such as mpirun's; else empty."""
    lines = [line.strip() for line in stderr.splitlines() if re.search(r"\w", line)]
    if re.search(r"\w", stdout) or any(line.startswith(OWN_ERRORS) for line in lines):
        return ""
    return " ".join(lines)


def wrong_start(case: Case, trace: Trace) -> str | None:
    """First deviation of the run's start from the scene by more than rounding, as a message; None if there is none."""
    chain = case.chain
    if trace.height_m is None or trace.velocity_m_s is None:
        return None
    rounded = ROUNDINGS * float(np.spacing(furthest_m(chain)))
    resting = np.maximum(chain.overlap_m, 0.0)
    force = (
        chain.stiffness * (hertz_force(1.0, resting + rounded) - hertz_force(1.0, resting))
        + START_TOLERANCE * chain.force_N.max()
    )
    if chain.lateral is not None and chain.lateral.velocity_m_s.any():
        # YADE shears contacts for one step before its first forces
        bore = chain.lateral.bore
        force = force + max(chain.lateral.friction, bore.friction if bore else 0.0) * chain.force_N.max()
    fastest = float(np.abs(trace.velocity_m_s).max())
    speed = START_TOLERANCE * fastest + case.scene.time_step_s * (force + np.append(force[1:], 0.0)) / chain.mass_kg
    for name, unit, start, expected, allowed in (
        ("height", "m", trace.height_m[0], chain.height_m, np.full(chain.bodies, rounded)),
        ("force below", "N", trace.force_N[0], chain.force_N, force),
        ("velocity", "m/s", trace.velocity_m_s[0], chain.velocity_m_s, speed),
    ):
        wrong = np.abs(start - expected) > allowed
        if wrong.any():
            body = int(np.argmax(wrong))
            text, expected_text = digits_apart(float(start[body]), float(expected[body]))
            return f"body {body + 1} starts with a {name} of {text} {unit}, the scene has {expected_text} {unit}"
    return None


def _blown_up(case: Case, engine: Engine, message: str, before: Trace | None) -> str | None:
    """Message on a blow-up of a failed run, from its samples or the code's error message; None if there was none."""
    reason = reason_to_fail(case, before) if before is not None else None
    if engine.loss_message and engine.loss_message in message and not (reason or "").startswith(UNSTABLE):
        seen = 0 if before is None else len(before.time_s)
        reason = f"{UNSTABLE}{case.sample_times_s[min(seen, case.scene.samples - 1)]:g} s: a body was lost"
    return reason


def reason_to_fail(case: Case, trace: Trace) -> str | None:
    """Message on a trace that cannot be right, with the time of the first fault; None if there is no fault."""
    return unstable(case, trace) or wrong_energy(case, trace)


def unstable(case: Case, trace: Trace) -> str | None:
    """Message on values that are not finite, or beads that pass through the wall or each other; None without such."""
    faults = [(int(np.argmax(wrong)), message) for wrong, message in _faults(case, trace) if wrong.any()]
    if not faults:
        return None
    first, message = min(faults, key=lambda fault: fault[0])
    return f"{UNSTABLE}{trace.time_s[first]:g} s: {message}"


def wrong_energy(case: Case, trace: Trace) -> str | None:
    """Message on a change of the total energy beyond the effects of step and rounding; None if there is none.

    The energy must stay constant, or must not grow if contacts dissipate energy, within the truncation error of this
    step and the rounding error of heights. A run whose energy changes by more than was put in is unstable.
    """
    share, allowed = energy_error(case.chain, trace), explained_energy(case, trace)
    if not (share > allowed).any():
        return None
    since_s = trace.time_s[int(np.argmax(share > allowed))]
    does = "grows" if case.chain.damped or case.chain.slips else "is off"
    message = (
        f"the energy {does} by {share.max():.2g} times the energy put in; at this time step at most {allowed:.2g} times"
    )
    return f"{UNSTABLE if share.max() > 1 else WRONG_ENERGY}{since_s:g} s: {message} is expected"


def _faults(case: Case, trace: Trace) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """Kinds of faults: a mask of the samples that have it, and its message."""
    chain = case.chain
    finite = np.isfinite(trace.force_N).all(axis=1) & np.isfinite(trace.total_energy_J)
    yield np.logical_not(finite), "values are not finite"
    if trace.height_m is not None:
        below = np.column_stack([np.full(len(trace.height_m), chain.wall_height_m), trace.height_m[:, :-1]])
        passed = trace.height_m < below
        passed[:, 0] &= chain.wall is not None
        body = int(np.argmax(passed.any(axis=0)))
        beneath = f"body {body}" if body else "the wall"
        yield np.asarray(passed.any(axis=1)), f"body {body + 1} passed through {beneath}"
    through = hertz_force(chain.stiffness, chain.smaller_radius_m)  # force at an overlap of a radius
    yield np.asarray((trace.force_N > through).any(axis=1)), "beads are pressed into each other by more than a radius"


def not_modelled(chain: Chain, trace: Trace) -> str | None:
    """Message if a striker above the tube comes down to its upper end, which no deck models; else None."""
    bore = chain.bore
    if bore is None or chain.bodies - 1 in bore.guided or trace.height_m is None:
        return None
    radius = float(chain.radius_m[-1])
    below = sqrt(radius**2 - bore.radius_m**2) if np.isfinite(radius) and radius > bore.radius_m else 0.0
    down = trace.height_m[:, -1] - below < bore.top_m
    when = f"at t = {trace.time_s[int(np.argmax(down))]:g} s the striker comes down to the end of the tube"
    return f"{when}: lower tube.top" if down.any() else None


def energy_error(chain: Chain, trace: Trace) -> Array:
    """Energy error (``drivers.chain.trace.energy_error_J``) divided by the energy put in. Shape (samples,)."""
    change = energy_error_J(trace.total_energy_J, damped=chain.damped, slips=chain.slips)
    scale = energy_scale_J(chain, trace)
    if scale:
        return np.asarray(change / scale)
    rounded = ROUNDINGS * float(np.spacing(furthest_m(chain)))  # overlap by rounding of bodies that just touch
    return np.asarray(np.where(change > hertz_energy(chain.stiffness.sum(), rounded), np.inf, 0.0))


def energy_scale_J(chain: Chain, trace: Trace) -> float:
    """Energy put in; that of a drive is the one really there, as its bound may be many times larger."""
    bound = energy_put_in(chain, float(trace.time_s[-1]))
    if trace.drive_work_J is None:
        return bound
    return min(float(max(np.abs(trace.drive_work_J).max(), trace.kinetic_energy_J.max())) or bound, bound)


def explained_energy(case: Case, trace: Trace) -> float:
    """Largest ``energy_error`` explained by velocity Verlet at the case's step and by rounding.

    The truncation error scales as the square of the step divided by the stability limit, and grows as a random walk
    with the number of impacts. Heights are rounded at every step; the net force on a body does work along this
    rounding. The work of a drive has an error by the distance of samples.
    """
    chain, duration = case.chain, case.duration_s
    share, impacts = share_at_most(chain, duration, case.scene.time_step_s)
    share = min(share, 1.0)
    scale = energy_scale_J(chain, trace) or 1.0
    rounded = float(np.spacing(furthest_m(chain)))
    with np.errstate(over="ignore", invalid="ignore"):  # runs that blew up
        net = trace.force_N + chain.load_N
        net[:, :-1] -= trace.force_N[:, 1:]
        walked, held = (  # by the motion, and in the evaluation of the energy
            float(np.maximum(values.max(axis=0), -values.min(axis=0)).sum()) for values in (net, trace.force_N)
        )
        walked *= sqrt(case.scene.steps + 1)
        rounding = rounded * (tolerance("guard", "rounding").limit * walked + held) / scale
        if trace.velocity_m_s is not None:
            rounding += work_error_J(chain, trace.time_s, trace.force_N, trace.velocity_m_s) / scale
    walk = 1 + tolerance("guard", "impacts").limit * sqrt(impacts)
    friction = tolerance("guard", "friction").limit if chain.slips else 0.0
    truncation = min(tolerance("guard", "energy").limit * share**2 * walk, 1.0)
    return max(truncation + friction + (rounding if np.isfinite(rounding) else 0.0), tolerance("guard", "least").limit)
