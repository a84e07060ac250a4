"""A train of solitary waves behind a heavy striker: the force of each wave over that of the first.

It is read thirty contacts below the striker's own: that contact lies under the thirtieth bead from the top. There the
waves of a striker of up to four bead masses have parted to 1e-3 of their ratios; of eight, the fourth still gains 5 %.
"""

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.read.signals import peaks
from validation.independent.scipy_chain import forces_of

DISTANCE = 30  # contacts below the striker's
WAVES = 5
PROMINENCE = 1e-3  # of the range: by so much a wave stands out


def measure(case: Case, trace: Trace) -> dict[str, float]:
    """Ratios from the contact's maxima.

    Raises:
        ValueError: fewer than two waves come by.
    """
    return _ratios(case, trace.time_s, trace.force_N)


def theory(case: Case) -> dict[str, float]:
    """The same of the same chain by another integrator."""
    return _ratios(case, *forces_of(case.chain, float(case.sample_times_s[-1])))


def _ratios(case: Case, time_s: Array, force_N: Array) -> dict[str, float]:
    column = case.chain.bodies - 1 - DISTANCE
    if case.scene.striker is None or column < 1:
        raise ValueError(f"no contact {DISTANCE} below a striker's")
    found = [peak.value for peak in peaks(time_s, force_N[:, column], PROMINENCE)]
    if len(found) < 2:
        raise ValueError(f"{len(found)} waves at contact {column + 1} within run.duration")
    return {f"wave_{number}_over_first": value / found[0] for number, value in enumerate(found[1:WAVES], start=2)}


ORDINALS = ("second", "third", "fourth", "fifth")
QUANTITIES = {
    f"wave_{number}_over_first": f"force of the {word} wave over the first's, {DISTANCE} contacts below the striker's"
    for number, word in enumerate(ORDINALS, start=2)
}
SOURCE = "the same chain by scipy's DOP853 to 1e-10 a step, which shares no line with the integrators judged"
