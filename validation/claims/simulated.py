"""What the claims on simulated chains share: ``run`` stands for whichever engine computes them."""

from collections.abc import Callable
from functools import cache

from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.chain.chain import Array
from postproc.paper.quoted import quoted
from postproc.paper.simulate import Simulation, case_of
from postproc.paper.strikes import sensor_amplitude, strike_for
from postproc.read.signals import Peak, peaks

Run = Callable[[Case], Simulation]

BARE = ("gravity=", "wall=")  # a chain that nothing compresses
PROMINENCE = 0.005  # of a force's range: by so much a wave of a train stands out
COUNTED_SHARE = 0.05  # of the first wave of a train: waves that count
LONG = "run.duration=2 ms"


def signal(simulation: Simulation, contact: int) -> tuple[Array, Array]:
    """Times, and the force of a contact."""
    return simulation.trace.time_s, simulation.trace.force_N[:, contact - 1]


def waves(simulation: Simulation, contact: int, at_least: int = 1, prominence: float = PROMINENCE) -> list[Peak]:
    """The waves that pass a contact.

    Raises:
        InputError: fewer than ``at_least`` within the scene's duration.
    """
    found = peaks(*signal(simulation, contact), prominence=prominence)
    if len(found) < at_least:
        words = f"{len(found)} waves at contact {contact} within it"
        raise InputError(simulation.case.scene.file, "run.duration", words, f"long enough for {at_least}")
    return found


def significant(train: list[Peak]) -> float:
    """How many waves of a train exceed ``COUNTED_SHARE`` of its first, before one rises again: a reflected wave."""
    rising = next((i for i in range(1, len(train)) if train[i].value > train[i - 1].value), len(train))
    return float(sum(peak.value > COUNTED_SHARE * train[0].value for peak in train[:rising]))


def struck(run: Run, force_N: float, *settings: str) -> Simulation:
    """Table 1's chain under the strike that gives one of its amplitudes, or the same strike on a changed chain."""
    return run(case_of("table1", f"striker.speed={striker_speed(force_N)!r} m/s", *settings))


@cache
def striker_speed(force_N: float) -> float:
    """The striker speed that gives an amplitude of Table 1, m/s."""
    striker = strike_for(force_N, sensor_amplitude).case.scene.striker
    assert striker is not None
    return striker.speed


def largest_N() -> float:
    """The largest amplitude of Table 1."""
    return max(quoted().table1.force_N)


def smallest_N() -> float:
    """The smallest amplitude of Table 1."""
    return min(quoted().table1.force_N)
