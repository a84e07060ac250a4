"""What a chart can show of a run that failed: its samples as far as there are any, without those of a blow-up."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.contact_law import hertz_force
from drivers.chain.trace import Trace
from postproc.read.sensors import sensor_signals

BEYOND = 2.0  # times the largest force of the runs that finished: what is larger would flatten their curves


@dataclass(frozen=True)
class Failed:
    """A run that failed, at all sample times of its scene; NaN where it has no sample that can be shown.

    Attributes:
        trace: its times and forces. A sample is left out where any contact is beyond.
        signals: of its gauges, by name. Each of shape (samples,).
    """

    trace: Trace
    signals: dict[str, Array]


def failed_label(engine: str) -> str:
    """What a run that failed is called beside those that finished."""
    return f"{engine} (failed)"


def failed_runs(case: Case, refused: Mapping[str, Trace], finished: Mapping[str, Trace]) -> dict[str, Failed]:
    """Runs that failed as they stand beside those that finished.

    Args:
        case: that was run.
        refused: by engine, what there is of traces: maybe only the first samples, maybe no numbers.
        finished: by engine; where there is none, forces at overlaps of a radius are the largest.
    """
    chain = case.chain
    largest = [float(np.abs(trace.force_N).max()) for trace in finished.values()]
    most_N = BEYOND * (max(largest, default=0.0) or float(hertz_force(chain.stiffness, chain.smaller_radius_m).max()))
    return {engine: _failed(case, trace, most_N) for engine, trace in refused.items()}


def _failed(case: Case, trace: Trace, most_N: float) -> Failed:
    time_s = case.sample_times_s
    with np.errstate(over="ignore", invalid="ignore"):
        signals = sensor_signals(case.layout, trace)
    shown = {name: _shown(signal[:, None], len(time_s), most_N)[:, 0] for name, signal in signals.items()}
    return Failed(replace(trace, time_s=time_s, force_N=_shown(trace.force_N, len(time_s), most_N)), shown)


def _shown(values: Array, samples: int, most: float) -> Array:
    """So many samples: NaN where there are none, or where any value is no number or too large."""
    good = (np.abs(values) <= most).all(axis=1)  # not so of NaN
    kept = np.full((samples, values.shape[1]), np.nan)
    kept[: len(values)][good] = values[good]
    return kept
