"""Fig. 3: speed of the solitary wave against its amplitude.

Theory and discrete chains agree within 2.5 %. 1000 and 1460 MPa give the speeds of large waves within their stated
accuracy of 10 %, 1000 MPa alone those of small waves.

Contact force on the axis. At 600 and 1460 MPa the upper pair of curves is under gravity, and so is that of 1000 MPa,
which the paper describes and does not draw. Dots: Table 1, its F_m taken as the sensors' average and converted by Eq.
(6). Thin bars: stated accuracy; thick bars: sensors misplaced by 1 mm. Root mean square deviation of the dots for 600,
1000 and 1460 MPa: 22, 3 and 10 % at 5 and 2 N, 14, 7 and 17 % at the smaller amplitudes.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from drivers.engines import REFERENCE, installed_codes
from postproc.draw.plot import COLUMN_IN, GREY, Product, draw_codes, pyplot
from postproc.paper import quoted, strikes
from postproc.read.motion import Simulation, case_of, run_codes
from validation.reference.travelling_wave import solve_at_amplitude

FORCES_N = np.geomspace(0.03, 20, 13)
BY_CODES = FORCES_N[::4]  # amplitudes that the codes run, and enough for the straight line without gravity
START_BETA, BETA_STEPS = 1.4, 3  # of the iteration for Eq. (6): each step reduces the error about twentyfold
PRINTED = {600.0: 1, 1460.0: 5}  # number of the first curve of a modulus in the paper
COLOURS = {600.0: "#0072b2", 1000.0: "#009e73", 1460.0: "#d55e00"}
THEORY: dict[str, Any] = {"lw": 2.6, "ls": (0, (1.4, 1.1)), "alpha": 0.45}
CHAIN: dict[str, Any] = {"lw": 0.9, "ls": "-"}
XLIM_N, TICKS_M_S = (0.010, 190), (50, 70, 100, 150, 200)
DEVIATION = "speed_off_reference_share"


def make(runs: Path) -> Product:
    """Runs the strikes and draws them with the theory.

    Every point of a discrete chain is a simulation of a strike: V_s is the peak-to-peak speed between the sensors, F_m
    the mean peak of the contact forces between them, static part included. The table also holds the scores of the
    moduli. The spacetime diagram shows the weakest and the strongest strike by the reference, for the largest modulus
    with gravity.
    """
    moduli = quoted().ptfe_moduli_MPa
    curves = [*((modulus, True) for modulus in moduli), *((modulus, False) for modulus in PRINTED)]
    exact = {
        (*curve, force): strikes.strike_for(force, strikes.contact_peak, *_settings(*curve))
        for curve in curves
        for force in (FORCES_N if curve[1] else BY_CODES)
    }
    points = _points(exact, runs)
    theory = _theory(curves, float(points["static_N"].max()))
    experiment = _experiment()
    figure, axis = pyplot().subplots(figsize=(COLUMN_IN, 4.2), layout="constrained")
    axis.set(xscale="log", xlabel=r"$F_m$, contact force (N)", xlim=XLIM_N)
    axis.set(yscale="log", ylabel=r"$V_s$ (m/s)", ylim=(46, 330), yticks=TICKS_M_S, yticklabels=TICKS_M_S)
    axis.minorticks_off()
    _draw_curves(axis, curves, points[points["engine"] == REFERENCE], theory)
    by_code = {str(code): of_code for code, of_code in points.groupby("engine") if code != REFERENCE}
    draw_codes(axis, {code: (of_code["force_N"], of_code["speed_m_s"]) for code, of_code in by_code.items()}, 3.5)
    _draw_experiment(axis, experiment)
    off = f"speeds of the codes:\n{points[DEVIATION].abs().max():.1e} off at most"
    axis.text(0.98, 0.02, off, transform=axis.transAxes, ha="right", color=GREY)
    axis.legend(loc="upper left", handlelength=1.8, labelspacing=0.3)
    tables = [points, theory, experiment.assign(source="experiment")]
    tables += [strikes.score(modulus).assign(source="score") for modulus in moduli]
    stiffest = max(moduli)
    chains = {
        f"{force:g} N, {stiffest:g} MPa, with gravity ({REFERENCE})": exact[stiffest, True, force].trace
        for force in FORCES_N[[0, -1]]
    }
    return Product(figure, pd.concat(tables, ignore_index=True), chains)


def _settings(modulus_MPa: float, gravity: bool) -> list[str]:
    """Settings for the scene of Table 1."""
    modulus = f"materials.ptfe.youngs_modulus={modulus_MPa} MPa"
    return [modulus] if gravity else [modulus, "gravity="]


def _number(modulus_MPa: float, gravity: bool) -> float:
    """Number of the theoretical curve in the paper, NaN if there is none; the next number is the discrete chain."""
    return PRINTED.get(modulus_MPa, np.nan) + 2 * gravity


def _points(exact: dict[tuple[float, bool, float], Simulation], runs: Path) -> pd.DataFrame:
    """Table of strikes, a row per strike and engine."""
    chosen, pairs = [key for key in exact if key[2] in BY_CODES], [*exact.items()]
    cases = {code: [exact[key].case for key in chosen] for code in installed_codes()}
    for simulations in run_codes(cases, runs).values():
        pairs += zip(chosen, simulations, strict=True)
    table = pd.DataFrame([
        {
            "source": "simulated", "engine": simulation.engine, "curve": _number(modulus, gravity) + 1,
            "modulus_MPa": modulus, "gravity": gravity,
            "striker_m_s": strikes.striker_speed(simulation), "force_N": strikes.contact_peak(simulation),
            "static_N": strikes.static_force(simulation.case),
            "sensor_amplitude_N": strikes.sensor_amplitude(simulation),
            "speed_m_s": strikes.speed_between_sensors(simulation),
        }
        for (modulus, gravity, _), simulation in pairs
    ])  # fmt: skip
    by_strike = table[table["engine"] == REFERENCE].set_index("striker_m_s")["speed_m_s"]
    table[DEVIATION] = table["speed_m_s"] / table["striker_m_s"].map(by_strike) - 1
    return table


def _theory(curves: list[tuple[float, bool]], static_N: float) -> pd.DataFrame:
    """Eqs. (3) and (4) at the same amplitudes, with the static force between the sensors."""
    tables = []
    for curve in curves:
        particles = strikes.particles_of(case_of("table1", *_settings(*curve)))
        source, static, speeds = "Eq. (3)", 0.0, [strikes.speed_from_force(particles, force) for force in FORCES_N]
        if curve[1]:
            source, static = "Eq. (4)", static_N
            speeds = [strikes.precompressed_speed(particles, force, static) for force in FORCES_N]
        columns = {"curve": _number(*curve), "modulus_MPa": curve[0], "gravity": curve[1], "force_N": FORCES_N}
        tables.append(pd.DataFrame({"source": source} | columns | {"static_N": static, "speed_m_s": speeds}))
    return pd.concat(tables)


def _experiment() -> pd.DataFrame:
    """Measured points of Table 1 at the contact force that Eq. (6) gives for the averages of the sensors."""
    points, static = strikes.measured_points(), strikes.static_force(case_of("table1"))
    average, beta = points["force_N"], np.array([_beta(each, static) for each in points["force_N"]])
    error_N = beta * points["force_error_N"]
    return points.assign(
        force_N=beta * average + static, force_error_N=error_N, sensor_amplitude_N=average, static_N=static
    )


def _beta(average_N: float, static_N: float) -> float:
    """Beta of Eq. (6) for the travelling wave with this average; it does not depend on modulus and mass."""
    beta = START_BETA
    for _ in range(BETA_STEPS):
        force_N = beta * average_N + static_N
        beta = solve_at_amplitude(1.0, 1.0, static_N, force_N / static_N - 1).beta
    return beta


def _draw_curves(axis: Any, curves: list[tuple[float, bool]], chains: pd.DataFrame, theory: pd.DataFrame) -> None:
    """Draws the paper's curves with their numbers, and the curve of the third modulus under gravity."""
    for modulus, gravity in curves:
        of_curve = {"modulus_MPa": modulus, "gravity": gravity}
        chain, equation = (table.merge(pd.DataFrame([of_curve])) for table in (chains, theory))
        look, number = CHAIN | {"color": COLOURS[modulus]}, _number(modulus, gravity)
        label = {"textcoords": "offset points", "va": "center"}
        first, *_, last = zip(chain["force_N"], chain["speed_m_s"], strict=True)
        if modulus in PRINTED:
            axis.plot(equation["force_N"], equation["speed_m_s"], **(look | THEORY))
            axis.annotate(f"{number}, {number + 1}", first, (-5, 0), ha="right", **label)
        axis.plot(chain["force_N"], chain["speed_m_s"], **look)
        if gravity:
            axis.annotate(f"{modulus:g} MPa", last, (6, 0), **label)
    for words, look in (("theory (1, 3, 5, 7)", THEORY), ("discrete chain (2, 4, 6, 8)", CHAIN)):
        axis.plot([], [], color=GREY, label=words, **look)


def _draw_experiment(axis: Any, experiment: pd.DataFrame) -> None:
    """Draws dots with thin bars of the stated accuracy and thick bars of the error by the sensor positions."""
    words = "experiment, by Eq. (6)"
    dots: dict[str, Any] = {"data": experiment, "fmt": "o", "color": "black", "ms": 3.5, "zorder": 5}
    stated: dict[str, Any] = {"xerr": "force_error_N", "yerr": "speed_error_m_s", "capsize": 1.5, "elinewidth": 0.7}
    axis.errorbar("force_N", "speed_m_s", label=words, **stated, **dots)
    axis.errorbar("force_N", "speed_m_s", yerr="speed_error_by_position_m_s", elinewidth=2, label=None, **dots)
