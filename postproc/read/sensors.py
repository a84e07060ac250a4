"""What gauges show: the mean of the two contact forces of a sensor bead, and the force on the wall.

Where the scene gives the time constant of their electronics, what these leave of it (``postproc.read.electronics``).
"""

from pathlib import Path

import numpy as np
import pandas as pd

from drivers.chain.chain import Array
from drivers.chain.layout import Layout
from drivers.chain.trace import Trace
from postproc.read.electronics import high_passed


def sensor_average(force_N: Array, from_wall: int) -> Array:
    """``(F_j + F_{j+1}) / 2`` of sensor bead j (the paper's Eq. 5); without a contact above, F_{j+1} is zero.

    Args:
        force_N: shape (samples, contacts).
        from_wall: the bead, counted from the wall.

    Returns:
        Shape (samples,).
    """
    below = force_N[:, from_wall - 1]
    above = force_N[:, from_wall] if from_wall < force_N.shape[1] else 0.0
    return np.asarray((below + above) / 2)


def sensor_signals(layout: Layout, trace: Trace) -> dict[str, Array]:
    """What all gauges show, by name: ``bead_9``, ``bead_5``, ..., and ``wall``. Each of shape (samples,)."""
    signals = {f"bead_{s.from_wall}": sensor_average(trace.force_N, s.from_wall) for s in layout.sensors}
    if layout.wall:
        signals["wall"] = trace.force_N[:, 0]
    constant = layout.time_constant_s
    if constant is None:
        return signals
    return {name: high_passed(trace.time_s, signal, constant) for name, signal in signals.items()}


def write_sensors(layout: Layout, trace: Trace, path: Path) -> None:
    """Writes ``sensors.csv`` in full precision."""
    columns = {f"{name}_N": signal for name, signal in sensor_signals(layout, trace).items()}
    pd.DataFrame({"time_s": trace.time_s} | columns).to_csv(path, index=False)
