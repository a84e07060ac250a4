"""Chains from which claims are computed; ``run`` is the function that runs a case on an engine."""

from collections.abc import Callable, Mapping
from functools import cache

import pandas as pd

from drivers.base.errors import InputError
from drivers.chain.case import Case
from postproc.paper.simulate import Simulation, case_of
from postproc.paper.strikes import Amplitude, sensor_amplitude, strike_for, striker_speed
from postproc.read.signals import Peak, envelope, peaks

Run = Callable[[Case], Simulation]
SolvedTable = Callable[[str, Amplitude], pd.DataFrame]  # Table 1 for a setting of its scene, a reading of its force

UNCOMPRESSED = ("gravity=", "wall=")
LONG_DURATION = "run.duration=2 ms"
PROMINENCE = 0.005  # of a wave in a train, divided by the range of the force
COARSE = ("run.time_step=0.2 us", "run.sample_interval=2 us")  # for long chains: errors of waves up to 1e-4
MICRO = 1e6


def waves(simulation: Simulation, contact: int, at_least: int = 1, prominence: float = PROMINENCE) -> list[Peak]:
    """Waves that pass a contact.

    Raises:
        InputError: fewer than ``at_least`` within the scene's duration.
    """
    trace = simulation.trace
    passing = peaks(trace.time_s, trace.force_N[:, contact - 1], prominence=prominence)
    if len(passing) < at_least:
        few = f"a run with {len(passing)} waves at contact {contact}"
        raise InputError(simulation.case.scene.file, "run.duration", few, f"a duration with {at_least}")
    return passing


def struck(run: Run, force_N: float, *settings: str) -> Simulation:
    """Table 1's chain under the strike for one of the amplitudes; settings change the chain, not the strike."""
    return run(case_of("table1", strike_of(force_N), *settings))


def strike_of(force_N: float) -> str:
    """Setting of the strike for an amplitude of Table 1."""
    return f"striker.speed={striker_speed_for(force_N)!r} m/s"


@cache
def striker_speed_for(force_N: float) -> float:
    """Striker speed for an amplitude of Table 1, m/s."""
    return striker_speed(strike_for(force_N, sensor_amplitude))


def heavy_strike(run: Run, *settings: str) -> Simulation:
    """Fig. 5's striker on sixty beads without gravity."""
    chain = ("gravity=", "chain.count=60", "run.duration=2.4 ms", *COARSE)
    return run(case_of("fig5", *chain, *settings))


def rate_through(train: list[Peak], maxima: float) -> float:
    """Rate of the exponential through a train's first maxima, per microsecond."""
    return envelope(train[: round(maxima)]).rate_per_s / MICRO


def ratio_of(values: Mapping[str, float], observable: str, over: str) -> float:
    """An observable, or its ratio to another."""
    return values[observable] / (values[over] if over else 1.0)
