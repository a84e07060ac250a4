"""Solitary waves of a wanted amplitude, from full simulations, the striker speed solved for: Table 1, and its moduli.

Table 1's amplitude is that of the sensors' averages above their static value, of a chain without lighter sensor beads,
E = 1.46 GPa, gravity on, the striker counted among the 21 beads: the reading that reproduces the printed numbers. Each
Young's modulus is scored by both readings, as the paper does not say whether its measured force is the contact's or the
sensors' average.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from math import exp, log
from operator import is_not
from pathlib import Path

import numpy as np
import pandas as pd

from drivers.base.errors import InputError, RunError
from drivers.chain.case import Case, build_case
from drivers.chain.chain import Array
from drivers.engines import REFERENCE
from postproc.paper.quoted import force_accuracy, quoted
from postproc.paper.simulate import Simulation, case_of, exact, run_codes, run_codes_on
from postproc.read.signals import first_peak
from validation.reference.travelling_wave import solve_travelling_wave

SCENE = "table1"
MARGIN, BEYOND = 1.3, 10  # a search sees this many times the travel time, to beads beyond the lower sensor
AFTER = 1.15  # times the arrival at the lower sensor: the run ends when the peak has passed
FOUND = 1e-12  # relative: where the search for a striker speed ends; the integration is good to 1e-11
CODE_AMPLITUDE = 1e-7  # relative: a code's amplitude counts as the one wanted
MAX_CORRECTIONS = 8
SEARCHED = 6.0  # about the logarithm of the estimated striker speed
COLUMNS = ("speed_m_s", "width_0.2pct_diameters", "width_4pct_diameters")
MEASURED = ("duration_us", "speed_m_s", "width_diameters")
STRIKER = "_striker_m_s"
SPREAD = "codes_largest_deviation_share"
NEARBY = 1.02  # ratio of striker speeds over which a slope is taken
HANDED_ON = 0.682  # of an equal striker's speed, to the leading wave's v_m: measured with the reference

Amplitude = Callable[[Simulation], float]


def sensor_pair(case: Case) -> tuple[int, int]:
    """The beads of the upper and the lower sensor; a scene that has not two of them is an InputError."""
    beads = [sensor.from_wall for sensor in case.layout.sensors]
    if len(beads) != 2:
        raise InputError(case.scene.file, "chain.sensors", f"{len(beads)} sensors", "two, between which a wave travels")
    return beads[0], beads[1]


def sensor_amplitude(simulation: Simulation) -> float:
    """Mean over the sensors of the peak of their averages above the static value, N: F_m of Table 1."""
    return float(np.mean([simulation.values[f"bead_{bead}_amplitude_N"] for bead in sensor_pair(simulation.case)]))


def contact_peak(simulation: Simulation) -> float:
    """Mean of the first peaks of the contact forces between the upper and the lower sensor, static part included."""
    upper, lower = sensor_pair(simulation.case)
    force = simulation.trace.force_N[:, lower:upper]
    firsts = [first_peak(simulation.trace.time_s, column - column[0]) for column in force.T]
    return float(np.mean(force[0] + [peak.value if peak else np.nan for peak in firsts]))


def static_force(case: Case) -> float:
    """Mean static force of the contacts between the upper and the lower sensor, N."""
    upper, lower = sensor_pair(case)
    return float(case.chain.force_N[lower:upper].mean())


READINGS: dict[str, Amplitude] = {"contact force": contact_peak, "average of the sensors": sensor_amplitude}


def striker_speed(simulation: Simulation) -> float:
    """That of the scene, m/s."""
    striker = simulation.case.scene.striker
    return striker.speed if striker else 0.0


def speed_between_sensors(simulation: Simulation) -> float:
    """Peak to peak, m/s."""
    upper, lower = sensor_pair(simulation.case)
    return simulation.values[f"speed_{upper}_to_{lower}_m_s"]


def strike(speed_m_s: float, duration_s: float, *settings: str) -> Case:
    """The chain of Table 1 under a striker of some speed, for whole microseconds."""
    duration = f"run.duration={np.ceil(duration_s * 1e6):.0f} us"
    return case_of(SCENE, *settings, f"striker.speed={speed_m_s!r} m/s", duration)


def strike_for(force_N: float, amplitude: Amplitude, *settings: str) -> Simulation:
    """The exact simulation of the strike that gives a wanted amplitude, just long enough to see it pass.

    The search starts from a wave without a static force; under one it is faster. RunError if no striker speed does it.
    """
    case, wave = strike(1.0, 1e-6, *settings), solve_travelling_wave()
    chain, j = case.chain, case.chain.beads // 2
    stiffness, mass = float(chain.stiffness[j]), float(chain.mass_kg[j])
    speed = float((force_N / (wave.force_by_velocity * stiffness**0.4 * mass**0.6)) ** (5 / 6) / HANDED_ON)
    beads = chain.beads - sensor_pair(case)[1] + BEYOND
    travel_s = beads / (wave.speed_by_force * stiffness ** (1 / 3) * mass**-0.5 * force_N ** (1 / 6))
    long = strike(speed, MARGIN * travel_s, *settings)

    @cache
    def excess(log_speed: float) -> float:
        with np.errstate(invalid="ignore", divide="ignore"):
            return float(np.log(amplitude(exact(_struck_at(long, exp(log_speed)))) / force_N))

    root = _root(excess, log(speed))
    if root is None:
        raise RunError(f"{SCENE}: no striker speed gives a wave of {force_N:g} N")
    found = exp(root)
    arrival_s = exact(_struck_at(long, found)).values[f"bead_{sensor_pair(long)[1]}_arrival_s"]
    return exact(strike(found, AFTER * arrival_s, *settings))


def _struck_at(case: Case, speed_m_s: float) -> Case:
    """The case with another striker speed in its chain alone: quick, for a search."""
    velocity = case.chain.velocity_m_s.copy()
    velocity[-1] = -speed_m_s
    return replace(case, chain=replace(case.chain, velocity_m_s=velocity))


def _root(excess: Callable[[float], float], start: float) -> float | None:
    """Where the logarithm of an amplitude over the one wanted is zero, by that of the striker speed.

    Without a static force it is a straight line of slope 6/5, which secants find at once; under one it bends.
    None where there is no such place within ``SEARCHED`` of the start.
    """
    from scipy.optimize import brentq, root_scalar

    first = excess(start)
    with warnings.catch_warnings(action="ignore"):  # where secants lose their way, the bracket below takes over
        found = root_scalar(excess, method="secant", x0=start, x1=start - first / 1.2, xtol=FOUND, maxiter=8)
    if found.converged and abs(found.root - start) < SEARCHED and abs(excess(float(found.root))) < 1e3 * FOUND:
        return float(found.root)
    ends = start - SEARCHED, start + SEARCHED
    return float(brentq(excess, *ends, xtol=FOUND)) if excess(ends[0]) < 0 < excess(ends[1]) else None


def solve_table1(runs: Path, *settings: str) -> pd.DataFrame:
    """A row per amplitude: the paper's columns, the striker speed and the three numbers by each engine, their spread.

    The spread is the largest deviation of any code from the reference's three numbers, NaN without a code.
    Codes start from the reference's speeds, corrected by their own amplitudes; RunError if one's do not settle.
    """
    forces = quoted().table1.force_N
    exact_ones = [strike_for(force, sensor_amplitude, *settings) for force in forces]
    solved = run_codes_on([simulation.case for simulation in exact_ones], runs)
    for _ in range(MAX_CORRECTIONS):
        cases = {code: [*map(_corrected, own, forces)] for code, own in solved.items()}
        unsettled = [code for code, own in solved.items() if any(map(is_not, cases[code], (one.case for one in own)))]
        if not unsettled:
            break
        solved = run_codes(cases, runs)  # settled ones are found again by content
    else:
        raise RunError(f"{SCENE}: the striker speed of {', '.join(unsettled)} does not settle on the amplitude wanted")
    return _table1({REFERENCE: exact_ones} | solved)


def exact_table1(amplitude: Amplitude, *settings: str) -> pd.DataFrame:
    """Table 1 by the reference alone, the amplitude read in one of the ways of ``READINGS``."""
    return _table1({REFERENCE: [strike_for(force, amplitude, *settings) for force in quoted().table1.force_N]})


def _table1(solved: Mapping[str, Sequence[Simulation]]) -> pd.DataFrame:
    """A row per amplitude, the columns of each engine beside the paper's."""
    paper = quoted().table1.frame
    for engine, simulations in solved.items():
        lower = f"bead_{sensor_pair(simulations[0].case)[1]}"
        paper[engine + STRIKER] = [striker_speed(simulation) for simulation in simulations]
        paper[f"{engine}_speed_m_s"] = [speed_between_sensors(simulation) for simulation in simulations]
        for name in COLUMNS[1:]:
            paper[f"{engine}_{name}"] = [simulation.values[f"{lower}_{name}"] for simulation in simulations]
    exact = paper[[f"{REFERENCE}_{name}" for name in COLUMNS]].to_numpy()
    codes = [engine for engine in solved if engine != REFERENCE]
    off = [paper[[f"{code}_{name}" for name in COLUMNS]].to_numpy() / exact - 1 for code in codes]
    paper[SPREAD] = np.abs(off).max(axis=(0, 2)) if off else np.nan
    return paper


def _corrected(one: Simulation, force_N: float) -> Case:
    """The case at a speed corrected by its amplitude, which goes with v^(6/5); itself where that is the one wanted."""
    ratio, striker = sensor_amplitude(one) / force_N, one.case.scene.striker
    if abs(ratio - 1) <= CODE_AMPLITUDE or striker is None:
        return one.case
    striker = striker.model_copy(update={"speed": striker.speed * ratio ** (-5 / 6)})
    return build_case(one.case.scene.model_copy(update={"striker": striker}))


def engines_of(table: pd.DataFrame) -> list[str]:
    """The engines whose columns a table has."""
    return [str(name).removesuffix(STRIKER) for name in table.columns if str(name).endswith(STRIKER)]


def measured_points() -> pd.DataFrame:
    """The experiment's points, their uncertainties as stated; that of the speed also as the sensors' places make it."""
    table, accuracy, case = quoted().table1, quoted().accuracy, case_of("table1")
    force, speed = np.array(table.force_N), np.array(table.measured_speed_m_s)
    share = np.array([force_accuracy(value) for value in table.force_N])
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
    other = exact(_struck_at(one.case, -NEARBY * float(one.case.chain.velocity_m_s[-1])))
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
