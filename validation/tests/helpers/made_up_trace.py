"""Invented readings of the scene ``example-measured``; ``python -m`` this module writes them."""

import numpy as np
import pandas as pd
from scipy.interpolate import make_interp_spline

from drivers.base import paths
from postproc.read.motion import case_of, exact
from postproc.read.observables import observe
from postproc.read.sensors import sensor_signals

SCENE = "example-measured"
FILE = paths.INPUTS / "measured" / f"{SCENE}.csv"
SETTINGS = ("materials.ptfe.youngs_modulus=1.35 GPa", "contact.restitution=0.97")  # of the underlying motion
CHANNELS = {"bead_9": ("CH1", 2.1), "bead_5": ("CH2", 2.1), "wall": ("CH3", 5.5)}  # gains in N/V
TRIGGER_US, INTERVAL_US, READINGS = 40.0, 2.0, 410
NOISE = 0.02  # of the amplitude
OFFSET_MV, DRIFT_MV_PER_US = 12.0, 0.05
SEED = 5
HEAD = (
    f"# INVENTED, not an experiment: exact motion of {SCENE} with {', '.join(SETTINGS)}, noise, an offset and a drift\n"
)


def made_up_trace() -> pd.DataFrame:
    """Table of times in us and readings of all channels in mV, to a tenth."""
    made = exact(case_of(SCENE, *SETTINGS))
    time_us = INTERVAL_US * np.arange(READINGS)
    clock_s = np.clip(time_us - TRIGGER_US, 0, None) * 1e-6
    random, columns = np.random.default_rng(SEED), {"time [us]": time_us}
    for gauge, signal in sensor_signals(made.case.layout, made.trace).items():
        name, gain = CHANNELS[gauge]
        force_N = make_interp_spline(made.trace.time_s, signal - signal[0], k=5)(clock_s)
        noise_N = random.normal(0.0, NOISE * made.values[f"{gauge}_amplitude_N"], READINGS)
        columns[f"{name} [mV]"] = np.round((force_N + noise_N) / gain * 1e3 + OFFSET_MV + DRIFT_MV_PER_US * time_us, 1)
    return pd.DataFrame(columns)


def true_values() -> dict[str, float]:
    """Observables of the underlying motion."""
    made = exact(case_of(SCENE, *SETTINGS))
    return observe(made.case.layout, made.trace)


if __name__ == "__main__":
    FILE.write_text(HEAD + made_up_trace().to_csv(index=False))
