"""Guard: checks of the output of a run before the run counts as done.

A run fails if it is not that of its scheme (``drivers.run.scheme``), or if its output rules out that comparison.
"""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.base.errors import RunError, digits_apart
from drivers.base.processes import STDERR, STDOUT, EndedProcess
from drivers.chain.case import Case
from drivers.chain.chain import Chain, above_rim_m, furthest_m, hertz_force
from drivers.chain.trace import Trace, with_work
from drivers.engines import Engine
from drivers.run.scheme import scheme_of

REASON_CHARACTERS = 300
UNSTABLE = "unstable at t = "  # beginning of messages
OWN_ERRORS = ("ERROR", "Traceback")  # beginnings of lines that lead to the code's own message
ROUNDINGS = 64  # largest deviation of a start in units in the last place of the coordinates


def checked_trace(case: Case, engine: Engine, outcome: EndedProcess, folder: Path) -> Trace:
    """Read a trace of a process that ended, check it, and compare it with the scheme of the engine.

    Raises:
        RunError: the run failed; with the partial trace if there is one.
    """
    stdout, stderr = ((folder / name).read_text(errors="replace") for name in (STDOUT, STDERR))
    if outcome.timed_out or outcome.code != 0:
        before = _left(case, engine, folder)
        blown_up = unstable(case, before) if before else None
        status, ending = "timeout", timed_out(outcome.limit_s, engine.loop_seconds(stdout))
        if not outcome.timed_out:
            message = _failed_start(stdout, stderr) or engine.failure_reason(stdout, stderr)
            message = "".join(c if c.isprintable() else " " for c in message)[:REASON_CHARACTERS]
            how = f"exit code {outcome.code}" if outcome.code > 0 else f"killed by signal {-outcome.code}"
            status, ending = "failed", f"{how}: {message}"
        raise RunError("; ".join(filter(None, (blown_up, ending))), status, partial=before)
    return compared(case, engine, checked(case, engine.read(case, folder)))


def checked(case: Case, trace: Trace) -> Trace:
    """Check a complete trace.

    Raises:
        RunError: it cannot be that of the case.
    """
    if reason := unstable(case, trace) or wrong_start(case.chain, trace) or not_modelled(case.chain, trace):
        raise RunError(reason, partial=trace)
    return trace


def compared(case: Case, engine: Engine, trace: Trace) -> Trace:
    """Compare a trace with the scheme of its engine; returns it with the work of the drive by that scheme.

    Raises:
        RunError: it departs from its scheme.
    """
    scheme = scheme_of(case, engine.name)
    try:
        if departure := scheme.departure(engine.name, trace):
            raise RunError(departure, partial=trace)
    except ArithmeticError as error:  # no exact motion to compare a run of ``reference`` with
        raise RunError(f"cannot be compared: {error}", partial=trace) from error
    return trace if case.chain.drive is None else with_work(trace, scheme.of(engine.name))


def timed_out(limit_s: float, loop_s: float | None = None) -> str:
    """Message on a run that was ended at its time limit, perhaps after its time loop."""
    hung = "" if loop_s is None else f"the time loop ended after {loop_s:g} s, but the program did not exit; "
    return f"{hung}killed at the time limit of {limit_s:g} s"


def _left(case: Case, engine: Engine, folder: Path) -> Trace | None:
    """Trace of a run that was ended: all of it, or the samples that it has written."""
    try:
        return engine.read(case, folder)
    except RunError as error:
        partial: Trace | None = error.partial
        return partial


def _failed_start(stdout: str, stderr: str) -> str:
    """Lines of the standard error of a program that failed before any output, such as mpirun's; else empty."""
    lines = [line.strip() for line in stderr.splitlines() if re.search(r"\w", line)]
    if re.search(r"\w", stdout) or any(line.startswith(OWN_ERRORS) for line in lines):
        return ""
    return " ".join(lines)


def wrong_start(chain: Chain, trace: Trace) -> str | None:
    """Message on a height at time 0 that is not that of the scene; None if all are those of the scene.

    Other deviations of a start are found by the comparison with the scheme, which has no heights.
    """
    if trace.height_m is None:
        return None
    off = np.abs(trace.height_m[0] - chain.height_m) > ROUNDINGS * np.spacing(furthest_m(chain))
    body = int(np.argmax(off))
    has, right = digits_apart(float(trace.height_m[0, body]), float(chain.height_m[body]))
    return f"body {body + 1} starts with a height of {has} m, the scene has {right} m" if off.any() else None


def unstable(case: Case, trace: Trace) -> str | None:
    """Message on values that are not finite, or beads that pass through the wall or each other; None without such."""
    faults = [(int(np.nonzero(wrong)[0][0]), message) for wrong, message in _faults(case, trace) if wrong.any()]
    if not faults:
        return None
    first, message = min(faults, key=lambda fault: fault[0])
    return f"{UNSTABLE}{trace.time_s[first]:g} s: {message}"


def _faults(case: Case, trace: Trace) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """Kinds of faults: a mask of the samples, or of samples and bodies, that have it, and its message."""
    chain = case.chain
    for values in (trace.force_N, trace.total_energy_J):
        yield ~np.isfinite(values), "values are not finite"
    if trace.height_m is not None:
        passed = np.empty(trace.height_m.shape, bool)
        passed[:, 0] = (trace.height_m[:, 0] < chain.wall_height_m) & (chain.wall is not None)
        np.less(trace.height_m[:, 1:], trace.height_m[:, :-1], out=passed[:, 1:])
        body = int(np.argmax(passed.any(axis=0)))
        beneath = f"body {body}" if body else "the wall"
        yield passed, f"body {body + 1} passed through {beneath}"
    through = hertz_force(chain.stiffness, chain.smaller_radius_m)  # force at an overlap of a radius
    yield np.asarray(trace.force_N > through), "beads are pressed into each other by more than a radius"


def not_modelled(chain: Chain, trace: Trace) -> str | None:
    """Message if a striker above the tube comes down to its upper end, which no deck models; else None."""
    bore = chain.bore
    if bore is None or chain.bodies - 1 in bore.guided or trace.height_m is None:
        return None
    down = trace.height_m[:, -1] - above_rim_m(float(chain.radius_m[-1]), bore.radius_m) < bore.top_m
    when = f"at t = {trace.time_s[int(np.argmax(down))]:g} s the striker comes down to the end of the tube"
    return f"{when}: lower tube.top" if down.any() else None
