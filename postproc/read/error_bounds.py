"""Bounds on the change of observables by a small change of all forces.

The local quintic spline of ``postproc.read.signals`` is linear in the samples around a maximum. A change of at most
``error_N`` in each sample changes its value by at most ``VALUE_WEIGHT error_N``, and its slope by at most
``SLOPE_WEIGHT error_N`` divided by the sample interval. The maximum, a root of the slope, moves by this slope divided
by the curvature: an arrival at a flat maximum is far less certain than the forces.
"""

import numpy as np

from drivers.chain.case import Layout
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.read.observables import of_kind
from postproc.read.sensors import sensor_signals
from postproc.read.signals import Peak, first_peak, pulses

# largest sums of the magnitudes of the spline's weights between two samples, for its value and its slope
VALUE_WEIGHT, SLOPE_WEIGHT = 1.81, 3.33
ELECTRONICS = 2.0  # largest gain of a first-order high-pass


def bounds_on_observables(layout: Layout, trace: Trace, values: dict[str, float], error_N: float) -> dict[str, float]:
    """Largest changes of the peaks and speeds of a run, in their units, if each force changes by up to ``error_N``.

    Args:
        layout: Properties of the chain.
        trace: The run.
        values: Its observables.
        error_N: Largest change of a force, so small that maxima keep their order and curvature.
    """
    gain = ELECTRONICS if layout.time_constant_s else 1.0
    bounds = dict.fromkeys(of_kind(values, "peak", "later peak"), gain * VALUE_WEIGHT * error_N)
    moved_s = {
        name: gain * error_N * _seconds_per_newton(trace.time_s, signal)
        for name, signal in sensor_signals(layout, trace).items()
    }
    for name in of_kind(values, "speed"):
        first, second = (f"bead_{number}" for number in name.split("_")[1:4:2])
        travel_s = values[f"{second}_arrival_s"] - values[f"{first}_arrival_s"]
        bounds[name] = abs(values[name] / travel_s) * (moved_s[first] + moved_s[second])
    return bounds


def _seconds_per_newton(time_s: Array, signal_N: Array) -> float:
    """Displacement of the first maximum by a change of all samples of 1 N, to first order; inf without a maximum."""
    waves = pulses(time_s, signal_N - signal_N[0])
    peak: Peak | None = waves[0] if waves else first_peak(time_s, signal_N)
    if peak is None or not 0 < peak.sample < len(signal_N) - 1:
        return float("inf")
    around = signal_N[peak.sample - 1 : peak.sample + 2]
    curvature = abs(float(around[0] - 2 * around[1] + around[2]))  # times the squared sample interval
    interval_s = float(time_s[1] - time_s[0])
    return float(np.divide(SLOPE_WEIGHT * interval_s, curvature)) if curvature else float("inf")
