"""Exactness of the reference that the error of a run needs."""

from math import floor, log10

from drivers.chain.case import Case
from drivers.chain.contact_law import hertz_force
from drivers.limits.energy_bounds import at_most, share_at_most
from validation.reference.adaptive import MIN_TOLERANCE

EXACT_SHARE = 1e-3  # of an error: allowed error of the exact motion against which it is measured
MAX_TOLERANCE = 1e-6  # of the reference, whose own values count as exact


def needed_tolerance(case: Case) -> float:
    """Tolerance of the reference that determines the force error of a run to 1 %: a power of ten.

    At a step of x times the stability limit, the force error of velocity Verlet is 0.25 x^2 times the largest change
    or more on all shipped scenes. Powers of ten let cases of similar steps share a run of the reference.
    """
    chain, duration = case.chain, float(case.sample_times_s[-1])
    force = hertz_force(chain.stiffness, at_most(chain, duration).overlap_m)
    change = float((force - chain.elastic_N).max() / (force.max() or 1.0))
    share, _ = share_at_most(chain, duration, case.scene.time_step_s)
    return float(10.0 ** floor(log10(min(max(EXACT_SHARE * share**2 * change, MIN_TOLERANCE), MAX_TOLERANCE))))
