"""Trial of a case before it runs: its motion by velocity Verlet at its own step, judged as a run is.

The predicted limit (``drivers.limits.stable_step``) is a lower bound. Of larger steps the scheme itself shows whether
they blow up: a light bead that is struck once, say, gains at a step that a standing contact could not have.
"""

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array, arrays_of, tube_arrays_of
from drivers.chain.trace import make_trace
from drivers.engines import TOTAL
from drivers.run.guard import reason_to_fail
from validation.reference.tube import integrate_tube
from validation.reference.velocity_verlet import integrate_verlet

MAX_BODY_STEPS, MAX_BODY_STEPS_3D = 20_000_000, 1_000_000  # bodies times steps: some tenths of a second
MAX_VALUES = 4_000_000  # bodies times samples, which are held at a time
SCAN = 1.02 ** np.arange(1, 106)  # steps are tried one by one, since stable ones lie between unstable ones
MAX_SCANNED = 200_000  # bodies times steps of each of them


def failure(case: Case, shear: str = TOTAL) -> str | None:
    """Words for a trial that fails, with the time, or takes too long; None for one that ends well.

    ``shear`` is the law of friction in three dimensions.
    """
    chain, scene = case.chain, case.scene
    most = MAX_BODY_STEPS if chain.lateral is None else MAX_BODY_STEPS_3D
    if scene.steps * chain.bodies > most or scene.samples * chain.bodies > MAX_VALUES:
        return "takes too long"
    timing = (scene.time_step_s, scene.steps_per_sample, scene.samples)
    with np.errstate(all="ignore"):
        if chain.lateral is None:
            moved = integrate_verlet(arrays_of(chain), *timing)
            motion: tuple[Array, ...] = (moved.force_N, chain.height_m + moved.displacement_m, moved.velocity_m_s)
        else:
            tube = integrate_tube(tube_arrays_of(chain), *timing, shear)
            motion = (tube.force_N, tube.place_m, tube.velocity_m_s, tube.spin_rad_s, tube.bore_N)
        reason = reason_to_fail(case, make_trace(chain, case.sample_times_s, *motion))
    return reason and f"is {reason.partition(' s:')[0]} s"


def first_failure_s(case: Case, from_s: float) -> float | None:
    """The smallest step at which a trial blows up, of those 2 % apart from ``from_s`` on; None where none is found."""
    for step in from_s * SCAN:
        tried = case.sampled_at_every(step)
        if tried.scene.steps * tried.chain.bodies > MAX_SCANNED:
            return None
        if failure(tried) is not None:
            return float(step)
    return None
