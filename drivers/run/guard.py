"""Guard: conditions that a finished run has to satisfy before it counts as done."""

from collections.abc import Iterator
from math import sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.base.errors import RunError
from drivers.base.processes import Outcome
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, energy_put_in, furthest_m
from drivers.chain.contact_law import hertz_energy, hertz_force
from drivers.chain.trace import Trace, energy_error_J
from drivers.engines import Engine
from drivers.limits.energy_bounds import share_at_most

REASON_CHARACTERS = 300
ROUNDINGS = 64  # units in the last place of coordinates that a start may be off by
START_TOLERANCE = 1e-9  # of the largest force and speed


def checked_trace(case: Case, engine: Engine, outcome: Outcome, folder: Path) -> Trace:
    """The trace of a process that ended.

    Raises:
        RunError: it cannot count as done; with what there is of a trace.
    """
    if outcome.timed_out:
        raise RunError(f"killed at the time limit of {outcome.limit_s:g} s", status="timeout")
    if outcome.code != 0:
        stdout, stderr = ((folder / name).read_text(errors="replace") for name in ("stdout.txt", "stderr.txt"))
        ending = f"exit code {outcome.code}" if outcome.code > 0 else f"killed by signal {-outcome.code}"
        words = "".join(c if c.isprintable() else " " for c in engine.failure_reason(stdout, stderr))
        before = engine.partial_trace(case, folder)
        blown_up = _blown_up(case, engine, words, before)
        raise RunError("; ".join(filter(None, (blown_up, f"{ending}: {words[:REASON_CHARACTERS]}"))), partial=before)
    try:
        trace = engine.read(case, folder)
    except RunError as error:
        error.partial = engine.partial_trace(case, folder)
        raise
    reason = reason_to_fail(case, trace) or wrong_start(case, trace) or not_modelled(case.chain, trace)
    if reason:
        raise RunError(reason, partial=trace)
    return trace


def wrong_start(case: Case, trace: Trace) -> str | None:
    """First deviation of the start from the scene's, by more than rounding; None where there is none."""
    chain = case.chain
    if trace.height_m is None or trace.velocity_m_s is None:
        return None
    rounded = ROUNDINGS * float(np.spacing(furthest_m(chain)))
    resting = np.maximum(chain.overlap_m, 0.0)
    force = (
        chain.stiffness * (hertz_force(1.0, resting + rounded) - hertz_force(1.0, resting))
        + START_TOLERANCE * chain.force_N.max()
    )
    if chain.lateral is not None and chain.lateral.velocity_m_s.any():  # YADE shears for a step before its first forces
        bore = chain.lateral.bore
        force = force + max(chain.lateral.friction, bore.friction if bore else 0.0) * chain.force_N.max()
    fastest = float(np.abs(trace.velocity_m_s).max())
    speed = START_TOLERANCE * fastest + case.scene.time_step_s * (force + np.append(force[1:], 0.0)) / chain.mass_kg
    for name, unit, found, expected, allowed in (
        ("height", "m", trace.height_m[0], chain.height_m, np.full(chain.bodies, rounded)),
        ("velocity", "m/s", trace.velocity_m_s[0], chain.velocity_m_s, speed),
        ("force below", "N", trace.force_N[0], chain.force_N, force),
    ):
        wrong = np.abs(found - expected) > allowed
        if wrong.any():
            body = int(np.argmax(wrong))
            one, other = float(found[body]), float(expected[body])
            digits = 9 if f"{one:.9g}" != f"{other:.9g}" else 17
            return f"body {body + 1} starts with a {name} of {one:.{digits}g} {unit}, the scene has {other:.{digits}g}"
    return None


def _blown_up(case: Case, engine: Engine, words: str, before: Trace | None) -> str | None:
    """Blow-up of a run that ended badly, as its samples or its engine's words show it; None where there is none."""
    seen = 0 if before is None else len(before.time_s)
    reason = reason_to_fail(case, before) if before is not None else None
    if reason is None and engine.loss_message and engine.loss_message in words:
        reason = f"unstable at t = {case.sample_times_s[min(seen, case.scene.samples - 1)]:g} s: a body was lost"
    return reason


def reason_to_fail(case: Case, trace: Trace) -> str | None:
    """Reason why a trace cannot be right, with the time from which on; None where nothing is wrong.

    Values have to be finite, beads must not pass through the wall or each other, and the energy has to stay what the
    scene put in, as nearly as the scheme at this step and the rounding of heights can keep it; where contacts lose
    energy, it must not grow.
    """
    faults = [(int(np.argmax(wrong)), words) for wrong, words in _faults(case, trace) if wrong.any()]
    if not faults:
        return None
    first = min(sample for sample, _ in faults)
    words = next(words for sample, words in faults if sample == first)
    return f"unstable at t = {trace.time_s[first]:g} s: {words}"


def _faults(case: Case, trace: Trace) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """Faults of samples: which have them, and the words for it."""
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
    through = hertz_force(chain.stiffness, chain.smaller_radius_m)  # the force at an overlap of a radius
    yield np.asarray((trace.force_N > through).any(axis=1)), "beads are pressed into each other by more than a radius"
    share, allowed = energy_error(chain, trace), explained_energy(case, trace)
    worst = np.nan_to_num(share, nan=np.inf).max()
    does = "grows" if chain.damped or chain.slips else "is off"
    words = f"the energy {does} by {worst:.2g} times what the scene puts in, of which this time step explains"
    yield share > allowed, f"{words} {allowed:.2g}"


def not_modelled(chain: Chain, trace: Trace) -> str | None:
    """When a striker above the tube comes down onto its end, which no deck models; None where it does not."""
    bore = chain.bore
    if bore is None or chain.bodies - 1 in bore.guided or trace.height_m is None:
        return None
    radius = float(chain.radius_m[-1])
    below = sqrt(radius**2 - bore.radius_m**2) if np.isfinite(radius) and radius > bore.radius_m else 0.0
    down = trace.height_m[:, -1] - below < bore.high_m
    when = f"at t = {trace.time_s[int(np.argmax(down))]:g} s the striker comes down to the end of the tube"
    return f"{when}: lower tube.top" if down.any() else None


def energy_error(chain: Chain, trace: Trace) -> Array:
    """By how much the energy errs (``drivers.chain.trace``) over what the scene puts in. Shape (samples,)."""
    change = energy_error_J(trace.total_energy_J, damped=chain.damped, slips=chain.slips)
    scale = energy_put_in(chain, float(trace.time_s[-1]))
    if scale:
        return np.asarray(change / scale)
    rounded = ROUNDINGS * float(np.spacing(furthest_m(chain)))  # bodies that just touch may be pressed as deep
    return np.asarray(np.where(change > hertz_energy(chain.stiffness.sum(), rounded), np.inf, 0.0))


def explained_energy(case: Case, trace: Trace) -> float:
    """The largest energy error that velocity Verlet at the case's step and rounding can make, as ``energy_error``.

    Verlet's goes with the square of the step's share of the stability limit, and walks on from impact to impact;
    heights are rounded at every step, and what forces are left on a body works along that.
    """
    chain, duration = case.chain, float(case.sample_times_s[-1])
    share, impacts = share_at_most(chain, duration, case.scene.time_step_s)
    share = min(share, 1.0)
    scale = energy_put_in(chain, duration) or 1.0
    rounded = float(np.spacing(furthest_m(chain)))
    above = np.column_stack([trace.force_N[:, 1:], np.zeros(len(trace.force_N))])
    with np.errstate(over="ignore", invalid="ignore"):  # of a run that blew up
        walked = float(np.abs(trace.force_N - above + chain.load_N).max(axis=0).sum() * np.sqrt(case.scene.steps + 1))
        held = float(np.abs(trace.force_N).max(axis=0).sum())  # rounded once, where the energy is evaluated
        rounding = rounded * (tolerance("guard", "rounding").limit * walked + held) / scale
    walk = 1 + tolerance("guard", "impacts").limit * sqrt(impacts)
    friction = tolerance("guard", "friction").limit if chain.slips else 0.0
    truncation = min(tolerance("guard", "energy").limit * share**2 * walk, 1.0)
    return max(truncation + friction + (rounding if np.isfinite(rounding) else 0.0), tolerance("guard", "least").limit)
