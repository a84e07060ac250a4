"""What a finished run has to satisfy before it counts as done."""

from pathlib import Path

import numpy as np

from drivers.case import Case
from drivers.chain import Array, Chain, energy_put_in
from drivers.engines import Engine
from drivers.errors import RunError
from drivers.process import Outcome
from drivers.tolerances import tolerance
from drivers.trace import Trace

LONGEST_COMPLAINT = 300


def checked_trace(case: Case, engine: Engine, outcome: Outcome, folder: Path) -> Trace:
    """The trace of a process that ended.

    Raises:
        RunError: it cannot count as done.
    """
    if outcome.timed_out:
        raise RunError(f"killed at the time limit of {outcome.limit_s:g} s", status="timeout")
    if outcome.code != 0:
        stdout, stderr = ((folder / name).read_text(errors="replace") for name in ("stdout.txt", "stderr.txt"))
        ending = f"exit code {outcome.code}" if outcome.code > 0 else f"killed by signal {-outcome.code}"
        words = "".join(c if c.isprintable() else " " for c in engine.complaint(stdout, stderr))
        raise RunError(f"{ending}: {words[:LONGEST_COMPLAINT]}")
    trace = engine.read(case, folder)
    reason = reason_to_fail(case.chain, trace)
    if reason:
        raise RunError(reason)
    return trace


def reason_to_fail(chain: Chain, trace: Trace) -> str | None:
    """Why a trace cannot be right, or None.

    Values have to be finite, beads must not pass through each other, and the energy has to stay what the scene
    put in.
    """
    finite = np.isfinite(trace.force_N).all(axis=1) & np.isfinite(trace.total_energy_J)
    if not finite.all():
        return f"not finite from t = {trace.time_s[np.argmin(finite)]:g} s on"
    through = chain.stiffness * chain.smaller_radius_m**1.5  # the force at an overlap of a radius
    passed = (trace.force_N > through).any(axis=1)
    if passed.any():
        return f"beads pressed through each other at t = {trace.time_s[np.argmax(passed)]:g} s: overlap beyond a radius"
    limit = tolerance("guard", "energy").limit
    share = energy_error(chain, trace)
    beyond = share > limit
    if beyond.any():
        worst = share.max()
        return (
            f"unstable at t = {trace.time_s[np.argmax(beyond)]:g} s: the energy is off by {worst:.2g} times what the"
            f" scene puts in (allowed {limit:g})"
        )
    return None


def energy_error(chain: Chain, trace: Trace) -> Array:
    """|E - E(0)| over what the scene puts in. Shape (samples,)."""
    change = np.abs(trace.total_energy_J - trace.total_energy_J[0])
    scale = energy_put_in(chain, float(trace.time_s[-1]))
    return np.asarray(change / scale if scale else np.where(change > 0, np.inf, 0.0))
