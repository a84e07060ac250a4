"""What two runs may differ by: rounding where they should be the same motion, truncation where they need not be."""

from dataclasses import dataclass
from math import isclose

from drivers.base.tolerances import Tolerance, tolerance
from drivers.engines import EXACT, load_engine
from validation.accuracy.tube_budget import model_quantity, why_unmeasured
from validation.compare.comparison import model_tolerance, shipped_name
from validation.compare.open_pair import Opened


@dataclass(frozen=True)
class Allowed:
    """Tolerances of two runs.

    Attributes:
        force: of the forces, as a share of the largest.
        peak, speed: relative errors.
        balance: of energies, momentum and impulse, over the largest of each.
        samples: how many can be compared: until rounding alone parts two runs.
    """

    force: Tolerance
    peak: Tolerance
    speed: Tolerance
    balance: Tolerance
    samples: int


def allowed_between(one: Opened, other: Opened) -> Allowed:
    """The tolerances of two runs.

    Of the same scheme at the same step they differ by rounding alone, in friction by their laws; others by what their
    time steps, or the lack of one, do.
    """
    same_step = isclose(one.run.record.time_step_s, other.run.record.time_step_s, rel_tol=1e-12)
    exact = [load_engine(each.engine).scheme == EXACT for each in (one, other)]
    if all(exact) or (not any(exact) and same_step):
        force, samples = _rounding(one, other)
        rest = _others(force)
        return Allowed(force, rest, rest, rest, samples)
    names = {shipped_name(each.case) for each in (one, other)}
    name = names.pop() if len(names) == 1 else None
    force = tolerance("truncation", "force", name)
    peak, speed = (tolerance("truncation", quantity, name) for quantity in ("peak", "speed"))
    return Allowed(force, peak, speed, _others(force), len(one.trace.time_s))


def _rounding(one: Opened, other: Opened) -> tuple[Tolerance, int]:
    """Of runs of one scheme at one step, and for how many samples they can be compared."""
    everything = len(one.trace.time_s)
    laws = {load_engine(each.engine).shear for each in (one, other)}
    if len(laws) > 1 and one.case.chain.lateral is not None and one.case.chain.slips:
        return tolerance("model", "sides"), everything
    if why_unmeasured(one.case) or why_unmeasured(other.case):
        return tolerance("model", model_quantity(one.case)), everything
    cases = [one.case] if one.case.scene == other.case.scene else [one.case, other.case]
    found = [model_tolerance(case, one.trace) for case in cases]
    return max((each for each, _ in found), key=lambda each: each.limit), min(samples for _, samples in found)


def _others(force: Tolerance) -> Tolerance:
    factor = tolerance("between", "others")
    return Tolerance(factor.limit * force.limit, f"{factor.limit:g} times the force's: {factor.reason}")
