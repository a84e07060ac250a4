"""The first wave of a run, as several measures read it: places, velocities, peaks."""

from functools import partial

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.read.signals import peak_in

first_wave = partial(peak_in, missing="no wave within run.duration")


def sensor_places(case: Case) -> tuple[int, int]:
    """Places from the wall of the lowest and the highest sensor; ValueError with fewer than two."""
    places = sorted(case.scene.chain.sensor_at)
    if len(places) < 2:
        raise ValueError("fewer than two sensors: the wave is read between two")
    return places[0], places[-1]


def velocity_down(trace: Trace) -> Array:
    """Downward velocities of all bodies, shape (samples, bodies); ValueError if they were not recorded."""
    if trace.velocity_m_s is None:
        raise ValueError("no state recorded; set run.record to forces and state")
    return -trace.velocity_m_s
