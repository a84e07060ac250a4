"""The error budget of a run: model, rounding, truncation and sampling, which add up to the whole.

With Q a quantity as the engine's run shows it, Q_h by velocity Verlet at the same step in absolute heights, Q_v the
same in overlaps, Q_e exact at the same samples and Q_t true (from finer samples):

* model = Q - Q_h: rounding in another order, unless something is wrong;
* rounding = Q_h - Q_v: of absolute coordinates;
* truncation = Q_v - Q_e: what the time step costs;
* sampling = Q_e - Q_t: a peak read from samples.

That of a three-dimensional run is ``validation.accuracy.tube_budget``'.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from threading import Lock
from typing import Any

import numpy as np

from drivers.chain.case import Case
from drivers.chain.trace import Trace
from drivers.engines import EXACT, IN_HEIGHTS, load_engine
from validation.accuracy.error_measures import FORCE, Truth, errors_of, quantities, truth_of, verlet_of
from validation.accuracy.parts import Parts
from validation.accuracy.rounding import verlet_in_heights
from validation.accuracy.tube_budget import sideways_budget
from validation.reference.adaptive import LEAST_TOLERANCE

LARGEST = 20_000  # bodies
TOO_LARGE = f"not measured: the exact motion of more than {LARGEST} bodies costs more than most runs of them"


@dataclass(frozen=True)
class Yardsticks:
    """What a case's runs are measured with.

    Attributes:
        heights: velocity Verlet at the case's step, its forces in absolute heights.
        verlet: the same in overlaps.
    """

    truth: Truth
    heights: Trace
    verlet: Trace


_last: dict[str, Yardsticks] = {}  # of the last case asked for: its engines share them
_making = Lock()


def yardsticks(case: Case) -> Yardsticks:
    """Those of a case.

    Raises:
        ArithmeticError: the exact motion cannot be followed.
    """
    key = f"{load_engine('verlet').render(case).sha256} {case.layout}"  # what gauges show is part of the truth
    with _making:  # engines that run side by side wait for the first
        if key not in _last:
            verlet = verlet_of(case)
            made = Yardsticks(truth_of(case), verlet_in_heights(case), verlet)
            _last.clear()
            _last[key] = made
        return _last[key]


def error_budget(case: Case, engine: str, trace: Trace) -> tuple[list[dict[str, Any]], str]:
    """The parts of the error of the force and of all quantities a run shows, and why some or all are left out."""
    if case.chain.lateral is not None:
        return sideways_budget(case, engine, trace)
    if case.chain.bodies > LARGEST:
        return [], TOO_LARGE
    try:
        rods = yardsticks(case)
    except ArithmeticError as error:
        return [], f"not measured: {error}"
    parts, unseen = parts_of(case, engine, trace, rods)
    note = "" if rods.truth.sampling_known else "sampling not measured: too many samples"
    if load_engine(engine).scheme == EXACT:
        note = "; ".join(filter(None, (note, f"exact to its tolerance, {LEAST_TOLERANCE:g}: nothing here measures it")))
    if unseen:
        note = "; ".join(filter(None, (note, f"not in the run, but in the exact motion: {', '.join(unseen)}")))
    return [asdict(each) for each in parts], note


def measured_errors(case: Case, trace: Trace, names: Iterable[str]) -> dict[str, float]:
    """Errors of the named quantities of a run against the exact motion, which is known to its tolerance."""
    truth = truth_of(case.full) if case.full else yardsticks(case).truth
    found = errors_of(case, trace, truth, names)
    return {name: max(error, LEAST_TOLERANCE) for name, error in found.items()}


def parts_of(case: Case, engine: str, trace: Trace, rods: Yardsticks) -> tuple[list[Parts], list[str]]:
    """The parts of the error of each quantity, the force first; and what the run should show and does not."""
    scheme = load_engine(engine).scheme
    exact = rods.truth.trace
    verlet = exact if scheme == EXACT else rods.verlet
    heights = rods.heights if scheme == IN_HEIGHTS else verlet
    stages = (trace, heights, verlet, exact)

    difference = np.abs(trace.force_N - exact.force_N)
    sample, column = np.unravel_index(int(np.argmax(difference)), difference.shape)
    largest = float(np.abs(exact.force_N).max()) or 1.0
    values = [float(stage.force_N[sample, column]) / largest for stage in stages]
    where = f"contact {column + 1} at {trace.time_s[sample] * 1e6:g} us"
    found = [_parts(FORCE, [*values, values[-1]], where)]

    seen = [*(quantities(case, stage) for stage in stages), rods.truth.true]
    unseen = []
    for name, true in rods.truth.true.items():
        if not true:
            continue
        if all(name in stage for stage in seen):
            found.append(_parts(name, [stage[name] / abs(true) for stage in seen]))
        elif name not in seen[0]:
            unseen.append(name)
    return found, unseen


def _parts(quantity: str, shares: list[float], where: str = "") -> Parts:
    run, heights, verlet, exact, true = shares
    return Parts(quantity, run - true, run - heights, heights - verlet, verlet - exact, exact - true, where)
