"""What a run is warned of: an error to expect by its scheme, forces that its scheme does not explain."""

from collections.abc import Iterator

import numpy as np

from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace, until
from drivers.engines import EXACT, load_engine
from postproc.read.residual import residual
from validation.accuracy.baseline import VERLET, baseline_of
from validation.accuracy.schemes import verlet_of


def warnings_of(case: Case, engine: str, trace: Trace) -> list[str]:
    """What to say of a run that is done and of little use; nothing of most."""
    if case.chain.lateral is not None and baseline_of(case, engine).unknown:
        return []
    try:
        return [*_of_error(case, engine), *_of_model(case, engine, trace)]
    except ArithmeticError as failed:
        return [f"its error cannot be predicted: {failed}"]


def _of_error(case: Case, engine: str) -> Iterator[str]:
    """Where the error that is predicted passes a tenth."""
    error, limit = predicted_error(case, engine), tolerance("warning", "force").limit
    beyond = error > limit
    if beyond.any():
        since = case.sample_times_s[int(np.argmax(beyond))]
        by_step = case.chain.lateral is not None or predicted_error(case, VERLET).max() > limit
        yield (
            f"forces are predicted to be off by up to {error.max():.2g} of the largest, by more than {limit:g} from"
            f" t = {since:g} s on, by {'the time step' if by_step else 'the rounding of heights so far from 0'}"
        )


def _of_model(case: Case, engine: str, trace: Trace) -> Iterator[str]:
    """Where a code differs from the same scheme at the same step by more than rounding does."""
    baseline = baseline_of(case, engine)
    if load_engine(engine).in_repository or baseline.unknown:
        return
    scheme, allowed = baseline.in_overlaps, baseline.allowed.limit
    apart = residual(until(trace, len(scheme.time_s)), scheme)[: baseline.samples]
    if not (apart <= allowed).all():
        since = case.sample_times_s[int(np.argmax(~(apart <= allowed)))]
        yield (
            f"forces differ from velocity Verlet at the same step by {apart.max():.2g} of the largest, from"
            f" t = {since:g} s on, where rounding explains {allowed:.1g}: what ran is not what the scene says"
        )


def predicted_error(case: Case, engine: str) -> Array:
    """Largest force error by the engine's scheme at each sample where that is known, over the largest force.

    Against the exact motion; of chains that are too long for it, against the same scheme at half the step.

    Raises:
        ArithmeticError: the exact motion cannot be followed.
    """
    baseline = baseline_of(case, engine)
    with np.errstate(over="ignore", invalid="ignore"):  # too large a step blows up
        if not baseline.unknown:
            error = residual(baseline.scheme_of(engine), baseline.exact)
        elif load_engine(engine).scheme == EXACT:
            error = np.zeros(case.scene.samples)
        else:  # it goes with the step squared, or where contacts lose energy with the step
            finer = verlet_of(case.at(2 * case.scene.steps_per_sample))
            error = residual(baseline.plain, finer) * (2 if case.chain.damping_ratio else 4 / 3)
    return np.nan_to_num(error, nan=np.inf)
