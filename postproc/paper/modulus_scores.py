"""The measured speeds of Table 1 against simulated ones: how far each Young's modulus is from them.

The paper does not say whether its measured force is the contact's or the sensors' average: both readings are kept.
"""

from functools import cache

import numpy as np
import pandas as pd

from drivers.chain.chain import Array
from postproc.paper.quoted import quoted
from postproc.paper.simulate import case_of
from postproc.paper.strikes import (
    Amplitude,
    contact_peak,
    sensor_amplitude,
    sensor_pair,
    speed_between_sensors,
    strike_for,
    struck_faster,
)

READINGS: dict[str, Amplitude] = {"contact force": contact_peak, "average of the sensors": sensor_amplitude}
NEARBY = 1.02  # ratio of striker speeds over which a slope is taken


def measured_points() -> pd.DataFrame:
    """The experiment's points with their stated uncertainties.

    The accuracy of the force goes linearly with its logarithm from that quoted for large amplitudes to that for
    small ones. That of the speed is given as quoted, and as the error of each sensor's place makes it.
    """
    table, accuracy, case = quoted().table1, quoted().accuracy, case_of("table1")
    force, speed = np.array(table.force_N), np.array(table.measured_speed_m_s)
    ends = np.log([force.min(), force.max()])
    share = np.interp(np.log(force), ends, [accuracy.force_small, accuracy.force_large])
    upper, lower = sensor_pair(case)
    gap = float(case.chain.height_m[upper - 1] - case.chain.height_m[lower - 1])
    return pd.DataFrame({
        "force_N": force, "speed_m_s": speed, "force_error_N": share * force,
        "speed_error_m_s": accuracy.speed * speed,
        "speed_error_by_position_m_s": np.sqrt(2) * accuracy.sensor_position_m / gap * speed,
    })  # fmt: skip


@cache
def _simulated(force_N: float, modulus_MPa: float, reading: Amplitude) -> tuple[float, float]:
    """Speed between the sensors at an amplitude in m/s, and the slope of its logarithm by that of the amplitude."""
    one = strike_for(force_N, reading, f"materials.ptfe.youngs_modulus={modulus_MPa} MPa")
    other = struck_faster(one, NEARBY)
    speed, faster = speed_between_sensors(one), speed_between_sensors(other)
    return speed, float(np.log(faster / speed) / np.log(reading(other) / reading(one)))


def deviations(modulus_MPa: float, reading: Amplitude) -> Array:
    """Measured over simulated speed, less 1. Shape (amplitudes,)."""
    points = measured_points()
    simulated = np.array([_simulated(force, modulus_MPa, reading)[0] for force in points["force_N"]])
    return np.asarray(points["speed_m_s"].to_numpy() / simulated - 1)


def scores() -> pd.DataFrame:
    """How far the experiment is from each modulus, with gravity, in per cent of speed and in standard errors.

    The error of the force enters with the slope of the simulated speed.
    """
    points, tables = measured_points(), []
    forces = points["force_N"].to_numpy()
    for name, reading in READINGS.items():
        for modulus in quoted().ptfe.moduli_MPa:
            speeds, slope = np.array([_simulated(force, modulus, reading) for force in forces]).T
            off = deviations(modulus, reading)
            error = np.hypot(points["speed_error_m_s"] / points["speed_m_s"], slope * points["force_error_N"] / forces)
            columns = {"force_read_as": name, "modulus_MPa": modulus, "force_N": forces}
            columns |= {"measured_m_s": points["speed_m_s"], "simulated_m_s": speeds}
            columns |= {"deviation_pct": 100 * off, "deviation_standard_errors": off / error}
            tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)
