"""Fig. 2: a sensor bead: free body, forces, the coefficient β.

(a) is the bead as a free body, (b) shows its contact forces and their average, (c) the coefficient beta: that of the
solitary wave on a chain under a static force F_0, from its exact travelling wave, with points from full simulations
of a striker on such a chain. A point counts as a solitary wave if its amplitude no longer changes from one sensor to
the next, ten beads on.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.stack import draw_lines
from postproc.draw.style import COLUMN_IN, FAINT, MICRO, drawing_order, marker_of, pyplot
from postproc.paper.quoted import quoted
from postproc.paper.simulate import UNTIL_REFLECTED, Simulation, case_of, simulate, simulate_one
from postproc.paper.strikes import contact_peak, sensor_pair, static_force, strike_for
from postproc.read.sensors import sensor_average
from validation.reference.travelling_wave import solve_at_amplitude, solve_travelling_wave

CURVE = np.geomspace(0.1, 1e4, 31)
STRIKES = (1.0, 10.0, 100.0, 1e3, 1e4)  # amplitudes (F_m - F_0)/F_0 of the simulations
CHAIN = ("chain.count=60", "chain.sensors=[{ from_wall = 20 }, { from_wall = 10 }]", "gravity=")
STEADY = 1e-3  # relative change of the amplitude between the sensors
FACE, FACE_WORDS = "#d55e00", "#a34800"  # colours of the forces on the gauge's faces, and of their names
ARROW = {"arrowstyle": "-|>"}
SENSOR = 5  # bead of Fig. 4's chain shown in (b)


def make(runs: Path) -> Product:
    """Runs Fig. 4's scene for (b) and strikes on a precompressed chain for (c)."""
    figure, axes = pyplot().subplots(3, 1, figsize=(COLUMN_IN, 7.2), height_ratios=[0.95, 1.25, 1.6])
    _draw_free_body(axes[0])
    forces = _draw_forces(axes[1], runs)
    waves = _waves()
    points = _points(runs)
    _draw_beta(axes[2], waves, points)
    figure.subplots_adjust(hspace=0.42)
    # how much beta depends on the modulus: (largest - smallest) / mean over the moduli, per engine and amplitude
    both = pd.concat([waves, points], ignore_index=True)
    both["amplitude_over_static"] = both["amplitude_over_static"].map(lambda value: float(f"{value:.2g}"))
    beta = both.groupby(["engine", "amplitude_over_static"], sort=False)["beta"]
    spread = ((beta.max() - beta.min()) / beta.mean()).reset_index(name="beta_spread_over_moduli_share")
    tables = [forces, waves, points, spread.assign(panel="c, all moduli")]
    return Product(figure, pd.concat(tables, ignore_index=True))


def _chains() -> dict[float, tuple[str, ...]]:
    """Settings of the precompressed chain by modulus in MPa; the static force is Table 1's between its sensors."""
    pressed = (*CHAIN, f"chain.precompression={static_force(case_of('table1'))!r} N")
    return {modulus: (*pressed, f"materials.ptfe.youngs_modulus={modulus} MPa") for modulus in quoted().ptfe.moduli_MPa}


def _draw_free_body(axis: Any) -> None:
    """Caps of mass M, a gauge of mass m between them, contact forces outside, F_3 and F_4 on the gauge's faces."""
    from matplotlib.patches import Rectangle, Wedge

    sensor = quoted().sensor
    axis.set(xlim=(-3.4, 3.4), ylim=(-1.15, 1.3), aspect="equal")
    axis.axis("off")
    axis.set_title("(a) the sensor bead", loc="left")
    for side, outer, inner in ((-1, "$F_1$", "$F_3$"), (1, "$F_2$", "$F_4$")):
        centre = 0.12 * side
        cap = Wedge((centre, 0), 1, -90 * side, -90 * side + 180, facecolor="#f2f2f2", edgecolor="black", lw=0.8)
        axis.add_patch(cap)
        axis.text(centre + 0.45 * side, 0.2, "M", ha="center", va="center")
        axis.annotate("", (centre + side, 0), (centre + 2.1 * side, 0), arrowprops=ARROW | {"color": "black"})
        axis.text(centre + 1.8 * side, 0.14, outer, ha="center")
        axis.annotate("", (0.14 * side, -0.5), (0.75 * side, -0.5), arrowprops=ARROW | {"color": FACE})
        axis.text(0.6 * side, -0.45, inner, color=FACE_WORDS, ha="center", va="bottom")
    axis.add_patch(Rectangle((-0.12, -0.85), 0.24, 1.7, facecolor="#e69f00", edgecolor="black", lw=0.8))
    axis.text(0, 1.08, f"gauge, m = {sensor.gauge_g:g} g; caps, 2M = {sensor.caps_g:g} g", ha="center", va="bottom")


def _draw_forces(axis: Any, runs: Path) -> pd.DataFrame:
    found = simulate_one(case_of("fig4", UNTIL_REFLECTED), runs)
    time = found[REFERENCE].trace.time_s
    near = np.abs(time - found[REFERENCE].values[f"bead_{SENSOR}_arrival_s"]) < 90e-6
    forces = {}
    for engine, one in found.items():  # above, below, and what the gauge reads
        force_N = one.trace.force_N[near]
        forces[engine] = np.column_stack([force_N[:, SENSOR], force_N[:, SENSOR - 1], sensor_average(force_N, SENSOR)])
    draw_lines(axis, time[near], forces)
    first, second, average = forces[REFERENCE].T
    time_us = time[near] * MICRO
    for force, label, side in ((first, "$F_1$", -1), (second, "$F_2$", 1)):
        top = int(np.argmax(force))
        axis.annotate(label, (time_us[top], force[top]), xytext=(12 * side, 1), textcoords="offset points",
                      ha="center", va="bottom")  # fmt: skip
    rise = int(np.argmax(average > 0.4 * average.max()))
    axis.annotate("average", (time_us[rise], average[rise]), xytext=(-10, 4), textcoords="offset points",
                  ha="right", arrowprops={"arrowstyle": "-", "lw": 0.5})  # fmt: skip
    axis.set(xlabel="time since impact (µs)", ylabel="force (N)")
    axis.set_ylim(top=1.18 * float(first.max()))
    axis.set_title(f"(b) contact forces of bead {SENSOR}, Fig. 4's scene", loc="left")
    axis.legend(loc="upper right", handlelength=1.6)
    names = ["F1_N", "F2_N", "average_N"]
    tables = [pd.DataFrame(columns, columns=names).assign(panel="b", engine=engine, time_s=time[near])
              for engine, columns in forces.items()]  # fmt: skip
    return pd.concat(tables, ignore_index=True)


def _waves() -> pd.DataFrame:
    """Beta of the travelling wave for each modulus, in SI units throughout: that it is the same is a result."""
    tables = []
    for modulus, settings in _chains().items():
        chain = case_of("table1", *settings).chain
        stiffness, mass = float(chain.stiffness[1]), float(chain.mass_kg[0])
        beta = [solve_at_amplitude(stiffness, mass, chain.precompression_N, amplitude).beta for amplitude in CURVE]
        columns = {"panel": "c", "engine": "travelling wave", "modulus_MPa": modulus}
        tables.append(pd.DataFrame(columns | {"amplitude_over_static": CURVE, "beta": beta}))
    return pd.concat(tables, ignore_index=True)


def _dynamic_peak(simulation: Simulation) -> float:
    return contact_peak(simulation) - static_force(simulation.case)


def _points(runs: Path) -> pd.DataFrame:
    """Beta from full simulations by every engine."""
    cases = {}
    for modulus, settings in _chains().items():
        static = static_force(case_of("table1", *settings))
        for amplitude in STRIKES:
            cases[modulus, amplitude] = strike_for(amplitude * static, _dynamic_peak, *settings).case
    rows = []
    for engine, simulations in simulate(list(cases.values()), runs).items():
        for (modulus, _), simulation in zip(cases, simulations, strict=True):
            beads = sensor_pair(simulation.case)
            upper, lower = (simulation.values[f"bead_{bead}_amplitude_N"] for bead in beads)
            peak = _dynamic_peak(simulation)
            rows.append({
                "panel": "c", "engine": engine, "modulus_MPa": modulus,
                "amplitude_over_static": peak / static_force(simulation.case),
                "beta": peak / ((upper + lower) / 2), "change_between_sensors": lower / upper - 1,
                "solitary": abs(lower / upper - 1) < STEADY,
            })  # fmt: skip
    return pd.DataFrame(rows)


def _draw_beta(axis: Any, waves: pd.DataFrame, points: pd.DataFrame) -> None:
    moduli = ", ".join(f"{modulus:g}" for modulus in sorted(waves["modulus_MPa"].unique()))
    limit = solve_travelling_wave().contact_over_average
    first = waves[waves["modulus_MPa"] == waves["modulus_MPa"].min()]
    axis.plot(first["amplitude_over_static"], first["beta"], color="black", lw=1, label="travelling wave")
    for engine in drawing_order(list(points["engine"].unique())):
        own = points[points["engine"] == engine]
        for solitary, label in ((True, engine), (False, None)):
            some, look = own[own["solitary"] == solitary], marker_of(engine)
            alpha = 1.0 if solitary else 0.35
            axis.plot(some["amplitude_over_static"], some["beta"], ls="", label=label, alpha=alpha, **look)
    for _, row in points[(points["engine"] == REFERENCE) & ~points["solitary"].astype(bool)].iloc[:1].iterrows():
        axis.annotate("not a solitary wave\n(still changes)", (row["amplitude_over_static"], row["beta"]), (0.11, 1.27),
                      color=FAINT, arrowprops={"arrowstyle": "-", "lw": 0.5, "color": FAINT})  # fmt: skip
    axis.axhline(limit, color=FAINT, lw=0.7, ls=(0, (2, 2)))
    axis.text(0.1, limit, f"no static force: {limit:.4f}", va="bottom", color=FAINT)
    axis.axhline(1, color=FAINT, lw=0.7, ls=(0, (2, 2)))
    axis.text(1e4, 1.003, "linear waves: 1", ha="right", va="bottom", color=FAINT)
    axis.set(xscale="log", xlabel=r"$(F_m - F_0)\,/\,F_0$", ylabel=r"$\beta$", ylim=(0.98, 1.46))
    axis.set_title("(c) peak contact force over peak average", loc="left")
    axis.legend(loc="lower right", bbox_to_anchor=(1, 0.08), fontsize=7, title=f"{moduli} MPa alike", title_fontsize=7)
