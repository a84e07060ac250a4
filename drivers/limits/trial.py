"""Trial of a case before a run: velocity Verlet at the scene's step, judged by the guard of runs.

The predicted limit (``drivers.limits.stable_step``) is a lower bound; a trial tests larger steps. For example, a light
bead that is struck once is stable at steps at which a lasting contact is unstable.
"""

import numpy as np

from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.engines import TOTAL
from drivers.run.guard import reason_to_fail

MAX_BODY_STEPS, MAX_BODY_STEPS_3D = 20_000_000, 1_000_000  # bodies times steps, some tenths of a second
MAX_VALUES = 4_000_000  # bodies times samples held in memory
SCAN = 1.02 ** np.arange(1, 106)  # factors on the first step; all are tried, as stable and unstable steps alternate
MAX_SCAN_BODY_STEPS = 200_000  # bodies times steps of one trial of a scan


def failure(case: Case, shear: str = TOTAL) -> str | None:
    """Reason why a trial fails, with its time, or ``takes too long``; None if the trial succeeds.

    ``shear`` is the friction law of three-dimensional scenes.
    """
    chain, scene = case.chain, case.scene
    most = MAX_BODY_STEPS if chain.lateral is None else MAX_BODY_STEPS_3D
    if scene.steps * chain.bodies > most or scene.samples * chain.bodies > MAX_VALUES:
        return "takes too long"
    with np.errstate(all="ignore"):
        reason = reason_to_fail(case, verlet_of(case, shear))
    return reason and f"is {reason.partition(' s:')[0]} s"


def first_failure_s(case: Case, from_s: float) -> float | None:
    """Smallest step in s at which a trial blows up, scanned in steps of 2 % from ``from_s``; None if none is found."""
    for step in from_s * SCAN:
        tried = case.sampled_at_every(step)
        if tried.scene.steps * tried.chain.bodies > MAX_SCAN_BODY_STEPS:
            return None
        if failure(tried) is not None:
            return float(step)
    return None
