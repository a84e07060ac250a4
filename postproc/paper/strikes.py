"""Solitary waves of a given amplitude, from full simulations that solve for the striker speed: Table 1 and its moduli.

The amplitude of Table 1 is the peak of the sensor averages above their static value, for a chain without lighter sensor
beads, with E = 1.46 GPa and gravity, and with the striker counted among the 21 beads: this reading reproduces the
printed numbers. Measured and simulated speeds are compared at equal averages as well.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from math import ceil, exp, floor, log, log10
from operator import is_not
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.interpolate import make_interp_spline
from scipy.optimize import brentq, root_scalar

from drivers.base.errors import InputError, RunError
from drivers.chain.case import Case, build_case
from drivers.chain.chain import Array
from drivers.engines import REFERENCE
from postproc.paper.quoted import force_accuracy, quoted
from postproc.read.motion import Simulation, case_of, exact, run_codes, run_codes_on
from postproc.read.signals import first_peak
from validation.reference.travelling_wave import solve_travelling_wave

SCENE = "table1"
MARGIN, BEADS_BELOW = 1.3, 10  # duration of a search: this many travel times, to this many beads below the lower sensor
END_FACTOR = 1.15  # duration of the final run divided by the arrival at the lower sensor, so that the peak has passed
SPEED_TOLERANCE = 1e-12  # relative, of the search for a striker speed; the integration is accurate to 1e-11
CODE_AMPLITUDE = 1e-7  # relative tolerance of a code's amplitude
MAX_CORRECTIONS = 8
SEARCH_RANGE = 6.0  # on either side of the logarithm of the estimated striker speed
COLUMNS = ("speed_m_s", "width_0.2pct_diameters", "width_4pct_diameters")
HALF_DIGITS = (0.5, 0.05, 0.05)  # of the printed numbers
MEASURED = ("duration_us", "speed_m_s", "width_diameters")
STRIKER = "_striker_m_s"
SPREAD = "codes_largest_deviation_share"
FITTED_STRIKES = 9  # between which the numbers of a row are interpolated
SPEED_RATIO = 1.02  # of the striker speeds that give a slope
WAVE_OVER_STRIKER = 0.682  # v_m of the leading wave divided by the speed of an equal striker, by the reference

Amplitude = Callable[[Simulation], float]


def sensor_pair(case: Case) -> tuple[int, int]:
    """Numbers of the beads with the upper and the lower sensor.

    Raises:
        InputError: The scene does not have two sensors.
    """
    beads = [sensor.from_wall for sensor in case.layout.sensors]
    if len(beads) != 2:
        raise InputError(
            case.scene.file, "chain.sensors", f"{len(beads)} sensors", "two sensors, for the speed between them"
        )
    return beads[0], beads[1]


def sensor_amplitude(simulation: Simulation) -> float:
    """Peak of the sensor averages above their static value, mean over the sensors, in N: F_m of Table 1."""
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


def striker_speed(simulation: Simulation) -> float:
    """Striker speed of the scene in m/s; 0 without a striker."""
    striker = simulation.case.scene.striker
    return striker.speed if striker else 0.0


def speed_between_sensors(simulation: Simulation) -> float:
    """Peak-to-peak speed between the two sensors in m/s."""
    upper, lower = sensor_pair(simulation.case)
    return simulation.values[f"speed_{upper}_to_{lower}_m_s"]


def strike(speed_m_s: float, duration_s: float, *settings: str) -> Case:
    """The chain of Table 1 with this striker speed, for a duration rounded up to a whole microsecond."""
    duration = f"run.duration={np.ceil(duration_s * 1e6):.0f} us"
    return case_of(SCENE, *settings, f"striker.speed={speed_m_s!r} m/s", duration)


def strike_for(force_N: float, amplitude: Amplitude, *settings: str) -> Simulation:
    """Exact simulation of the strike with a given amplitude, just long enough for the wave to pass the sensors.

    The search starts from the speed for a wave without static force.

    Raises:
        RunError: No striker speed gives the amplitude.
    """
    case, wave = strike(1.0, 1e-6, *settings), solve_travelling_wave()
    chain, j = case.chain, case.chain.beads // 2
    stiffness, mass = float(chain.stiffness[j]), float(chain.mass_kg[j])
    speed = float((force_N / (wave.force_by_velocity * stiffness**0.4 * mass**0.6)) ** (5 / 6) / WAVE_OVER_STRIKER)
    beads = chain.beads - sensor_pair(case)[1] + BEADS_BELOW
    travel_s = beads / (wave.speed_by_force * stiffness ** (1 / 3) * mass**-0.5 * force_N ** (1 / 6))
    long = strike(speed, MARGIN * travel_s, *settings)

    @cache
    def excess(log_speed: float) -> float:
        with np.errstate(invalid="ignore", divide="ignore"):
            return float(np.log(amplitude(exact(_struck_at(long, exp(log_speed)))) / force_N))

    root = _root(excess, log(speed))
    if root is None:
        raise RunError(f"{SCENE}: no striker speed gives a wave of {force_N:g} N")
    striker_m_s = exp(root)
    arrival_s = exact(_struck_at(long, striker_m_s)).values[f"bead_{sensor_pair(long)[1]}_arrival_s"]
    return exact(strike(striker_m_s, END_FACTOR * arrival_s, *settings))


def _struck_at(case: Case, speed_m_s: float) -> Case:
    """The case with another striker speed in its chain only, for a fast search."""
    velocity = case.chain.velocity_m_s.copy()
    velocity[-1] = -speed_m_s
    return replace(case, chain=replace(case.chain, velocity_m_s=velocity))


def _root(excess: Callable[[float], float], start: float) -> float | None:
    """Root of ``excess``, log(amplitude / target) as a function of the logarithm of the striker speed.

    Without static force it is a straight line of slope 6/5, and the secant method converges in one step. None if there
    is no root within ``SEARCH_RANGE`` of the start.
    """
    first = excess(start)
    with warnings.catch_warnings(action="ignore"):  # if the secant method diverges, the bracket below is used
        solution = root_scalar(
            excess, method="secant", x0=start, x1=start - first / 1.2, xtol=SPEED_TOLERANCE, maxiter=8
        )
    if (
        solution.converged
        and abs(solution.root - start) < SEARCH_RANGE
        and abs(excess(float(solution.root))) < 1e3 * SPEED_TOLERANCE
    ):
        return float(solution.root)
    ends = start - SEARCH_RANGE, start + SEARCH_RANGE
    return float(brentq(excess, *ends, xtol=SPEED_TOLERANCE)) if excess(ends[0]) < 0 < excess(ends[1]) else None


def table1_numbers(simulation: Simulation) -> list[float]:
    """Numbers of a row of Table 1, in the order of ``COLUMNS``."""
    lower = sensor_pair(simulation.case)[1]
    widths = [simulation.values[f"bead_{lower}_{name}"] for name in COLUMNS[1:]]
    return [speed_between_sensors(simulation), *widths]


@cache
def fitting_force(force_N: float, *settings: str) -> float:
    """Amplitude that gives most of the printed numbers of a row of Table 1, whose F_m is printed to one digit.

    It is F_m as printed if all numbers follow there. Else it is, of three digits, within the rounding of F_m and among
    the amplitudes that give most numbers, the one with the smallest largest miss; numbers are interpolated.
    """
    row, half_N = quoted().table1.frame.set_index("force_N").loc[force_N], 10 ** floor(log10(force_N)) / 2
    printed = row[[f"computed_{name}" for name in COLUMNS]].to_numpy()

    def misses(numbers: Array) -> Array:
        return np.asarray(np.abs(numbers - printed) / HALF_DIGITS)

    if (misses(np.array(table1_numbers(strike_for(force_N, sensor_amplitude, *settings)))) <= 1).all():
        return force_N
    ends = force_N - half_N, force_N + half_N
    slowest = strike_for(ends[0], sensor_amplitude, *settings)
    faster = np.geomspace(1.0, (ends[1] / ends[0]) ** (5 / 6), FITTED_STRIKES) * striker_speed(slowest)
    strikes = [exact(_struck_at(slowest.case, speed_m_s)) for speed_m_s in faster]
    numbers = make_interp_spline([*map(sensor_amplitude, strikes)], [*map(table1_numbers, strikes)])
    amplitudes = np.linspace(*ends, 101)
    off = misses(numbers(amplitudes))
    best = np.lexsort((off.max(axis=1), -(off <= 1).sum(axis=1)))[0]
    return float(round(amplitudes[best], 3 - ceil(log10(force_N))))


def resolved(run: Callable[[Case], Simulation], case: Case, force_N: float) -> Simulation:
    """Strike on an engine, with its speed corrected until the engine's own amplitude is right.

    Raises:
        RunError: the corrections do not converge.
    """
    for _ in range(MAX_CORRECTIONS):
        motion = run(case)
        case = _corrected(motion, force_N)
        if case is motion.case:
            return motion
    raise RunError(f"{SCENE}: the striker speed of {motion.engine} does not converge to the amplitude")


def solve_table1(runs: Path) -> pd.DataFrame:
    """Table 1: by amplitude the paper's columns, the striker speed and three numbers by each engine and their spread.

    The spread is the largest relative deviation of any code from the three numbers of the reference; NaN without a
    code. Codes start from the reference's striker speeds, which are corrected by the codes' own amplitudes.

    Raises:
        RunError: The corrections of a code do not converge.
    """
    forces = quoted().table1.force_N
    exact_ones = [strike_for(force, sensor_amplitude) for force in forces]
    solved = run_codes_on([simulation.case for simulation in exact_ones], runs)
    for _ in range(MAX_CORRECTIONS):
        cases = {code: [*map(_corrected, done, forces)] for code, done in solved.items()}
        unsettled = [code for code, done in solved.items() if any(map(is_not, cases[code], (one.case for one in done)))]
        if not unsettled:
            break
        solved = run_codes(cases, runs)  # unchanged cases are found again
    else:
        raise RunError(f"{SCENE}: the striker speed of {', '.join(unsettled)} does not converge to the amplitude")
    return _table1({REFERENCE: exact_ones} | solved)


def exact_table1(setting: str) -> pd.DataFrame:
    """Table 1 by the reference alone, for a setting of its scene."""
    return _table1({REFERENCE: [strike_for(force, sensor_amplitude, setting) for force in quoted().table1.force_N]})


def _table1(solved: Mapping[str, Sequence[Simulation]]) -> pd.DataFrame:
    """A row per amplitude, with the columns of the paper and of each engine."""
    paper = quoted().table1.frame
    for engine, simulations in solved.items():
        paper[engine + STRIKER] = [striker_speed(simulation) for simulation in simulations]
        paper[[f"{engine}_{name}" for name in COLUMNS]] = [table1_numbers(simulation) for simulation in simulations]
    exact = paper[[f"{REFERENCE}_{name}" for name in COLUMNS]].to_numpy()
    codes = [engine for engine in solved if engine != REFERENCE]
    off = [paper[[f"{code}_{name}" for name in COLUMNS]].to_numpy() / exact - 1 for code in codes]
    paper[SPREAD] = np.abs(off).max(axis=(0, 2)) if off else np.nan
    return paper


def _corrected(motion: Simulation, force_N: float) -> Case:
    """The case with a speed corrected by its amplitude, proportional to v^(6/5); unchanged if that is right."""
    ratio, striker = sensor_amplitude(motion) / force_N, motion.case.scene.striker
    if abs(ratio - 1) <= CODE_AMPLITUDE or striker is None:
        return motion.case
    striker = striker.model_copy(update={"speed": striker.speed * ratio ** (-5 / 6)})
    return build_case(motion.case.scene.model_copy(update={"striker": striker}))


def measured_points() -> pd.DataFrame:
    """Measured points with the stated uncertainties, and the speed error by the positions of the sensors."""
    paper, table, case = quoted(), quoted().table1, case_of("table1")
    force, speed = np.array(table.force_N), np.array(table.measured_speed_m_s)
    share = np.array([force_accuracy(value) for value in table.force_N])
    upper, lower = sensor_pair(case)
    gap = float(case.chain.height_m[upper - 1] - case.chain.height_m[lower - 1])
    return pd.DataFrame({
        "force_N": force, "speed_m_s": speed, "force_error_N": share * force,
        "speed_error_m_s": paper.accuracy_speed * speed,
        "speed_error_by_position_m_s": np.sqrt(2) * paper.accuracy_sensor_position_m / gap * speed,
    })  # fmt: skip


@cache
def _simulated(force_N: float, modulus_MPa: float, amplitude: Amplitude = sensor_amplitude) -> tuple[float, float]:
    """Speed between the sensors in m/s at an amplitude, and its logarithmic derivative by the amplitude."""
    motion = strike_for(force_N, amplitude, f"materials.ptfe.youngs_modulus={modulus_MPa} MPa")
    other = exact(_struck_at(motion.case, -SPEED_RATIO * float(motion.case.chain.velocity_m_s[-1])))
    speed, faster = speed_between_sensors(motion), speed_between_sensors(other)
    return speed, float(np.log(faster / speed) / np.log(amplitude(other) / amplitude(motion)))


def deviations(modulus_MPa: float, amplitude: Amplitude = sensor_amplitude) -> Array:
    """Relative deviation of the measured from the simulated speed at equal amplitudes. Shape (amplitudes,)."""
    points = measured_points()
    simulated = np.array([_simulated(force, modulus_MPa, amplitude)[0] for force in points["force_N"]])
    return np.asarray(points["speed_m_s"].to_numpy() / simulated - 1)


def scores() -> pd.DataFrame:
    """Deviation of the experiment from each modulus, with gravity, in per cent of the speed and in standard errors.

    The error of the force is converted by the slope of the simulated speed.
    """
    points, tables = measured_points(), []
    forces = points["force_N"].to_numpy()
    for modulus in quoted().ptfe_moduli_MPa:
        speeds, slope = np.array([_simulated(force, modulus) for force in forces]).T
        off = deviations(modulus)
        error = np.hypot(points["speed_error_m_s"] / points["speed_m_s"], slope * points["force_error_N"] / forces)
        columns = {"modulus_MPa": modulus, "force_N": forces, "measured_m_s": points["speed_m_s"]}
        columns |= {"simulated_m_s": speeds, "deviation_pct": 100 * off, "deviation_standard_errors": off / error}
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)
