"""Made-up experiments: motions of an independent integrator with noise, as files of measured traces."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from drivers.chain.case import Case
from drivers.chain.chain import arrays_of
from drivers.chain.schemes import exact_of
from drivers.chain.trace import Trace
from postproc.read.motion import case_of
from postproc.read.observables import observe
from postproc.read.signals import sensor_signals
from validation.tests.helpers.by_scipy import forces_at

MODULUS, MODULUS_PA = "materials.ptfe.youngs_modulus", 1.1e9
SHORT = ("chain.count=11", "run.duration=0.5 ms")  # of Fig. 4
LAWS = {  # key, value and settings of the truth
    "viscoelastic": ("contact.restitution", 0.85, ()),
    "power": ("contact.gamma", 0.5, ("contact.dissipation=power",)),
    "kuwabara-kono": ("contact.relaxation", 2e-6, ("contact.dissipation=kuwabara-kono",)),
}
NO_LAW = ("contact.dissipation=viscoelastic", *(f"{key}=" for key, *_ in LAWS.values()))
TRIGGER_S, INTERVAL_S, OFFSET_N = 40e-6, 1e-6, 0.3


@cache
def truth(law: str, scene: str, settings: tuple[str, ...]) -> tuple[Case, Trace]:
    """Case with the true modulus and law, and its motion by scipy's DOP853."""
    key, value, more = LAWS[law]
    true = f"{key}={value} {'s' * (key == 'contact.relaxation')}".strip()
    case = case_of(scene, *settings, *NO_LAW, *more, true, f"{MODULUS}={MODULUS_PA} Pa")
    force_N = forces_at(arrays_of(case.chain), case.sample_times_s)
    return case, replace(exact_of(case), force_N=force_N)


def true_observables(law: str, scene: str, settings: tuple[str, ...]) -> dict[str, float]:
    """Observables of the true motion."""
    case, trace = truth(law, scene, settings)
    return observe(case.layout, trace)


def make_up(
    path: Path, law: str, noise_N: float, seed: Sequence[int], scene: str, settings: tuple[str, ...],
    interval_s: float = INTERVAL_S, digit_N: float = 0.0,
) -> Path:  # fmt: skip
    """Write readings of all gauges with an offset and white noise, from before the impact to the end of the run."""
    (case, trace), random = truth(law, scene, settings), np.random.default_rng(seed)
    time_s = np.arange(0.0, TRIGGER_S + trace.time_s[-1], interval_s)
    columns = {"time_s": time_s}
    for gauge, signal in sensor_signals(case.layout, trace).items():
        force_N = np.interp(time_s - TRIGGER_S, trace.time_s, signal - signal[0], left=0.0)
        reading_N = force_N + random.normal(OFFSET_N, noise_N, len(time_s))
        columns[f"{gauge}_N"] = np.round(reading_N / digit_N) * digit_N if digit_N else reading_N
    pd.DataFrame(columns).to_csv(path, index=False)
    return path
