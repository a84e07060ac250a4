"""The error to expect of a run's forces, from the engines' own scheme: what a run is warned of."""

import numpy as np

from drivers.case import Case
from drivers.chain import Array
from drivers.engines import EXACT, IN_HEIGHTS, load_engine
from drivers.tolerances import tolerance
from postproc.residual import residual
from validation.budget import LARGEST, yardsticks
from validation.errors import verlet_of

VERLET = "verlet"


def warnings_of(case: Case, engine: str) -> list[str]:
    """What to say of a run that is predicted to err by more than a tenth; nothing of most."""
    try:
        error = predicted_error(case, engine)
    except ArithmeticError as failed:
        return [f"its error cannot be predicted: {failed}"]
    limit = tolerance("warning", "force").limit
    beyond = error > limit
    if not beyond.any():
        return []
    since = case.sample_times_s[int(np.argmax(beyond))]
    return [
        f"forces are predicted to be off by up to {error.max():.2g} of the largest, by more than {limit:g} from"
        f" t = {since:g} s on, by {_cause(case, limit)}"
    ]


def _cause(case: Case, limit: float) -> str:
    in_overlaps = predicted_error(case, VERLET).max()
    return "the time step" if in_overlaps > limit else "the rounding of heights so far from 0"


def predicted_error(case: Case, engine: str) -> Array:
    """Largest force error at each sample, over the largest force. Shape (samples,).

    Against the exact motion; of chains that are too long for it, against the same scheme at half the step.

    Raises:
        ArithmeticError: the exact motion cannot be followed.
    """
    scheme = load_engine(engine).SCHEME
    if scheme == EXACT:
        return np.zeros(case.scene.samples)
    with np.errstate(over="ignore", invalid="ignore"):  # too large a step blows up
        if case.chain.bodies > LARGEST:
            finer = verlet_of(case.at(2 * case.scene.steps_per_sample))
            error = residual(verlet_of(case), finer) * 4 / 3  # it goes with the step squared
        else:
            rods = yardsticks(case)
            error = residual(rods.heights if scheme == IN_HEIGHTS else rods.verlet, rods.truth.trace)
    return np.nan_to_num(error, nan=np.inf)
