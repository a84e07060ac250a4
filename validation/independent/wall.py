"""A solitary wave that meets a wall: the peak force there and that of the wave that comes back, over the incident one.

Both are read where the wave keeps its shape: at the lowest sensor's contact. The theory starts from the exact solitary
wave instead of a strike.
"""

from functools import cache

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.read.signals import first_peak, peaks
from validation.independent.scipy_chain import led_to_wall

DISTANCE = 10  # contacts above the sensor's at which the exact wave starts, and beads above that
PROMINENCE = 0.02  # of the range: by so much a wave stands out


def measure(case: Case, trace: Trace) -> dict[str, float]:
    """Ratios from the maxima of two contacts.

    Raises:
        ValueError: the wave does not come back within the run.
    """
    return _ratios(_place(case), trace.time_s, trace.force_N)


def theory(case: Case) -> dict[str, float]:
    """From the exact solitary wave and the wall's stiffness over that of the contacts between beads.

    Raises:
        ValueError: no wall or sensor, or a chain under load.
    """
    chain = case.chain
    if chain.load_N.any():
        raise ValueError("a chain under load, in which no wave is the exact one")
    return _reflected(_place(case), float(chain.stiffness[0] / chain.stiffness[1]))


@cache
def _reflected(place: int, wall_stiffness: float) -> dict[str, float]:
    start = place + DISTANCE
    # it is back at the sensor after 2 place + DISTANCE beads; those at the wall linger
    return _ratios(place, *led_to_wall(start + DISTANCE, start, wall_stiffness, 2.0 * place + DISTANCE + 8.0))


def _ratios(place: int, time_s: Array, force_N: Array) -> dict[str, float]:
    """Ratios to the first wave that passes contact ``place``."""
    incident, wall = first_peak(time_s, force_N[:, place - 1]), first_peak(time_s, force_N[:, 0])
    if incident is None or wall is None:
        raise ValueError("no wave at the sensor or at the wall within run.duration")
    back = [peak.value for peak in peaks(time_s, force_N[:, place - 1], PROMINENCE) if peak.time_s > wall.time_s]
    if not back:
        raise ValueError(f"no wave comes back to contact {place} within run.duration")
    return {
        "wall_peak_over_incident": wall.value / incident.value,
        "reflected_over_incident": max(back) / incident.value,
    }


def _place(case: Case) -> int:
    """The lowest sensor's bead, whose contact below is read.

    Raises:
        ValueError: there is no sensor or no wall.
    """
    if case.scene.wall is None or not case.scene.chain.sensors:
        raise ValueError("no wall, or no sensor to read the wave at")
    return min(sensor.from_wall for sensor in case.scene.chain.sensors)


QUANTITIES = {
    "wall_peak_over_incident": "largest force on the wall over that of the wave that comes",
    "reflected_over_incident": "force of the wave that goes back over that of the wave that comes",
}
SOURCE = "the exact solitary wave of the discrete chain, led to the wall by scipy's DOP853"
