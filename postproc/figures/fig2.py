"""Fig. 2: (a) the sensor bead as a free body; (b) its contact forces and their average; (c) the coefficient beta.

(c) is the solitary wave's on a chain under a static force F_0, from its exact travelling wave, with points from
full simulations of a striker on such a chain. A point counts as a solitary wave if its amplitude no longer changes
from one sensor to the next, ten beads on.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from postproc.product import Product
from postproc.quoted import quoted
from postproc.sensors import sensor_average
from postproc.style import COLUMN_IN, FAINT, drawing_order, line_of, marker_of, pyplot

if TYPE_CHECKING:
    from validation.simulate import Simulation

MODULI_MPA = (600, 1000, 1460)
STATIC_N = 0.0168  # what 14 beads weigh: the static force between the two sensors of the paper's chain of 21
CURVE = np.geomspace(0.1, 1e4, 31)
STRIKES = (1.0, 10.0, 100.0, 1e3, 1e4)  # amplitudes (F_m - F_0)/F_0 of the simulations
CHAIN = ("chain.count=45", "chain.sensors=[{ from_wall = 20 }, { from_wall = 10 }]", "gravity=",
         f"chain.precompression={STATIC_N} N")  # fmt: skip
STEADY = 1e-3  # relative change of the amplitude between the sensors
SENSOR = 5  # bead of Fig. 4's chain shown in (b)


def make(runs: Path) -> Product:
    """Runs Fig. 4's scene for (b) and strikes on a precompressed chain for (c)."""
    plt = pyplot()
    figure, axes = plt.subplots(3, 1, figsize=(COLUMN_IN, 7.2), height_ratios=[0.95, 1.25, 1.6])
    _draw_free_body(axes[0])
    forces = _draw_forces(axes[1], runs)
    waves = _waves()
    points = _points(runs)
    _draw_beta(axes[2], waves, points)
    figure.subplots_adjust(hspace=0.42)
    return Product(figure, pd.concat([forces, waves, points, _spread(waves, points)], ignore_index=True))


def _draw_free_body(axis: Any) -> None:
    """Caps of mass M, a gauge of mass m between them, contact forces outside, F_3 and F_4 on the gauge's faces."""
    from matplotlib.patches import Rectangle, Wedge

    sensor = quoted().sensor
    axis.set(xlim=(-3.4, 3.4), ylim=(-1.15, 1.3), aspect="equal")
    axis.axis("off")
    axis.set_title("(a) the sensor bead", loc="left")
    look: dict[str, Any] = {"facecolor": "#f2f2f2", "edgecolor": "black", "lw": 0.8}
    for side, name in ((-1, "1"), (1, "2")):
        centre = 0.12 * side
        axis.add_patch(Wedge((centre, 0), 1, -90 * side, -90 * side + 180, **look))
        axis.text(centre + 0.45 * side, 0.2, "M", ha="center", va="center")
        axis.annotate(
            "", (centre + side, 0), (centre + 2.1 * side, 0), arrowprops={"arrowstyle": "-|>", "color": "black"}
        )
        axis.text(centre + 1.8 * side, 0.14, f"$F_{name}$", ha="center")
        inner = "3" if side < 0 else "4"
        axis.annotate(
            "", (0.14 * side, -0.5), (0.75 * side, -0.5), arrowprops={"arrowstyle": "-|>", "color": "#d55e00"}
        )
        axis.text(0.6 * side, -0.45, f"$F_{inner}$", color="#d55e00", ha="center", va="bottom")
    axis.add_patch(Rectangle((-0.12, -0.85), 0.24, 1.7, facecolor="#e69f00", edgecolor="black", lw=0.8))
    axis.text(0, 1.08, f"gauge, m = {sensor.gauge_g:g} g; caps, 2M = {sensor.caps_g:g} g", ha="center", va="bottom")


def _draw_forces(axis: Any, runs: Path) -> pd.DataFrame:
    from validation.simulate import case_of, simulate

    found = {engine: one for engine, (one,) in simulate([case_of("fig4", "run.duration=0.9 ms")], runs).items()}
    tables = []
    for engine in drawing_order(list(found)):
        trace, line = found[engine].trace, line_of(engine)
        first, second = trace.force_N[:, SENSOR], trace.force_N[:, SENSOR - 1]  # the wave comes from above
        average = sensor_average(trace.force_N, SENSOR)
        near = np.abs(trace.time_s - found[engine].values[f"bead_{SENSOR}_arrival_s"]) < 90e-6
        time_us = trace.time_s[near] * 1e6
        for force in (first, second, average):
            axis.plot(time_us, force[near], color=line.colour, lw=line.width, ls=line.dashes)
        axis.plot([], [], color=line.colour, lw=line.width, ls=line.dashes, label=engine)
        columns = {"panel": "b", "engine": engine, "time_s": trace.time_s[near], "F1_N": first[near]}
        tables.append(pd.DataFrame(columns | {"F2_N": second[near], "average_N": average[near]}))
    for force, label, side in ((first, "$F_1$", -1), (second, "$F_2$", 1)):
        top = int(np.argmax(force[near]))
        axis.annotate(label, (time_us[top], force[near][top]), xytext=(12 * side, 1), textcoords="offset points",
                      ha="center", va="bottom")  # fmt: skip
    rise = int(np.argmax(average[near] > 0.4 * average[near].max()))
    axis.annotate("average", (time_us[rise], average[near][rise]), xytext=(-10, 4), textcoords="offset points",
                  ha="right", arrowprops={"arrowstyle": "-", "lw": 0.5})  # fmt: skip
    axis.set(xlabel="time since impact (µs)", ylabel="force (N)")
    axis.set_ylim(top=1.18 * float(first[near].max()))
    axis.set_title(f"(b) contact forces of bead {SENSOR}, Fig. 4's scene", loc="left")
    axis.legend(loc="upper right", handlelength=1.6)
    return pd.concat(tables, ignore_index=True)


def _waves() -> pd.DataFrame:
    """Beta of the travelling wave for each modulus, in SI units throughout: that it is the same is a result."""
    from validation.reference.precompressed_wave import solve_at_amplitude
    from validation.simulate import case_of

    tables = []
    for modulus in MODULI_MPA:
        chain = case_of("table1", *CHAIN, f"materials.ptfe.youngs_modulus={modulus} MPa").chain
        found = [solve_at_amplitude(float(chain.stiffness[1]), float(chain.mass_kg[0]), STATIC_N, a) for a in CURVE]
        columns = {"panel": "c", "engine": "travelling wave", "modulus_MPa": modulus}
        values = {"amplitude_over_static": CURVE, "beta": [wave.beta for wave in found]}
        tables.append(pd.DataFrame(columns | values))
    return pd.concat(tables, ignore_index=True)


def _points(runs: Path) -> pd.DataFrame:
    """Beta from full simulations by every engine."""
    from validation.simulate import simulate
    from validation.strikes import contact_peak, static_force, strike_for

    def dynamic_peak(simulation: "Simulation") -> float:
        return contact_peak(simulation) - static_force(simulation)

    wanted = [(modulus, amplitude) for modulus in MODULI_MPA for amplitude in STRIKES]
    cases = [strike_for(amplitude * STATIC_N, dynamic_peak, *CHAIN, f"materials.ptfe.youngs_modulus={modulus} MPa").case
             for modulus, amplitude in wanted]  # fmt: skip
    rows = []
    for engine, simulations in simulate(cases, runs).items():
        for (modulus, _), simulation in zip(wanted, simulations, strict=True):
            upper, lower = (
                simulation.values[f"bead_{s.from_wall}_amplitude_N"] for s in simulation.case.layout.sensors
            )
            peak = dynamic_peak(simulation)
            rows.append({
                "panel": "c", "engine": engine, "modulus_MPa": modulus, "amplitude_over_static": peak / STATIC_N,
                "beta": peak / ((upper + lower) / 2), "change_between_sensors": lower / upper - 1,
                "solitary": abs(lower / upper - 1) < STEADY,
            })  # fmt: skip
    return pd.DataFrame(rows)


def _draw_beta(axis: Any, waves: pd.DataFrame, points: pd.DataFrame) -> None:
    from validation.reference.travelling_wave import solve_travelling_wave

    limit = solve_travelling_wave().contact_over_average
    first = waves[waves["modulus_MPa"] == MODULI_MPA[0]]
    axis.plot(first["amplitude_over_static"], first["beta"], color="black", lw=1, label="travelling wave")
    for engine in drawing_order(list(points["engine"].unique())):
        own = points[points["engine"] == engine]
        for solitary, label in ((True, engine), (False, None)):
            some, look = own[own["solitary"] == solitary], marker_of(engine)
            alpha = 1.0 if solitary else 0.35
            axis.plot(some["amplitude_over_static"], some["beta"], ls="", label=label, alpha=alpha, **look)
    for _, row in points[(points["engine"] == "reference") & ~points["solitary"].astype(bool)].iloc[:1].iterrows():
        axis.annotate("not a solitary wave\n(still changes)", (row["amplitude_over_static"], row["beta"]), (0.11, 1.27),
                      color=FAINT, arrowprops={"arrowstyle": "-", "lw": 0.5, "color": FAINT})  # fmt: skip
    axis.axhline(limit, color=FAINT, lw=0.7, ls=(0, (2, 2)))
    axis.text(0.1, limit, f"no static force: {limit:.4f}", va="bottom", color=FAINT)
    axis.axhline(1, color=FAINT, lw=0.7, ls=(0, (2, 2)))
    axis.text(1e4, 1.003, "linear waves: 1", ha="right", va="bottom", color=FAINT)
    axis.set(xscale="log", xlabel=r"$(F_m - F_0)\,/\,F_0$", ylabel=r"$\beta$", ylim=(0.98, 1.46))
    axis.set_title("(c) peak contact force over peak average", loc="left")
    axis.legend(loc="lower right", bbox_to_anchor=(1, 0.1), title="600, 1000, 1460 MPa alike", title_fontsize=8)


def _spread(waves: pd.DataFrame, points: pd.DataFrame) -> pd.DataFrame:
    """How much beta depends on the modulus: (largest - smallest) / mean over the moduli, per engine and amplitude."""
    both = pd.concat([waves, points], ignore_index=True)
    both["amplitude"] = both["amplitude_over_static"].map(lambda value: float(f"{value:.2g}"))
    beta = both.groupby(["engine", "amplitude"], sort=False)["beta"]
    spread = (beta.max() - beta.min()) / beta.mean()
    table = (
        spread.rename("beta_spread_over_moduli_share").rename_axis(["engine", "amplitude_over_static"]).reset_index()
    )
    return table.assign(panel="c, all moduli")
