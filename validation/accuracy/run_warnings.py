"""What a run is warned of: an error to expect by its scheme, forces that its scheme does not explain."""

import numpy as np

from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from drivers.engines import EXACT, IN_HEIGHTS, load_engine
from postproc.read.residual import residual
from validation.accuracy.budget import LARGEST, yardsticks
from validation.accuracy.error_measures import verlet_of
from validation.accuracy.rounding import comparable
from validation.accuracy.tube_budget import sideways_warnings

VERLET = "verlet"


def warnings_of(case: Case, engine: str, trace: Trace) -> list[str]:
    """What to say of a run that is done and of little use; nothing of most."""
    if case.chain.lateral is not None:
        return sideways_warnings(case, engine, trace)
    try:
        return [*_of_error(case, predicted_error(case, engine)), *_of_model(case, engine, trace)]
    except ArithmeticError as failed:
        return [f"its error cannot be predicted: {failed}"]


def _of_error(case: Case, error: Array) -> list[str]:
    """Where the error that is predicted passes a tenth."""
    limit = tolerance("warning", "force").limit
    beyond = error > limit
    if not beyond.any():
        return []
    since = case.sample_times_s[int(np.argmax(beyond))]
    return [
        f"forces are predicted to be off by up to {error.max():.2g} of the largest, by more than {limit:g} from"
        f" t = {since:g} s on, by {_cause(case, limit)}"
    ]


def _of_model(case: Case, engine: str, trace: Trace) -> list[str]:
    """Where a code differs from the same scheme at the same step by more than rounding does."""
    if load_engine(engine).in_repository or case.chain.bodies > LARGEST:
        return []
    rods = yardsticks(case)
    rounding, samples = comparable(residual(rods.heights, rods.verlet))
    allowed = max(tolerance("model", "force").limit, rounding)
    apart = residual(trace, rods.verlet)[:samples]
    if not (apart > allowed).any():
        return []
    since = case.sample_times_s[int(np.argmax(apart > allowed))]
    return [
        f"forces differ from velocity Verlet at the same step by {apart.max():.2g} of the largest, from t = {since:g} s"
        f" on, where rounding explains {allowed:.1g}: what ran is not what the scene says"
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
    scheme = load_engine(engine).scheme
    if scheme == EXACT:
        return np.zeros(case.scene.samples)
    with np.errstate(over="ignore", invalid="ignore"):  # too large a step blows up
        if case.chain.bodies > LARGEST:
            finer = verlet_of(case.at(2 * case.scene.steps_per_sample))
            # it goes with the step squared, or where contacts lose energy with the step
            error = residual(verlet_of(case), finer) * (2 if case.chain.damping_ratio else 4 / 3)
        else:
            rods = yardsticks(case)
            error = residual(rods.heights if scheme == IN_HEIGHTS else rods.verlet, rods.truth.trace)
    return np.nan_to_num(error, nan=np.inf)
