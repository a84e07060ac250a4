"""Fig. 2: forces on a sensor bead and coefficient β.

The average of the two contact forces has a lower and longer pulse than each. Without static force its peak is 1.414
times lower; in linear waves β is 1.

(a) Forces on the parts of the particle. (b) Contact forces F_1, F_2 and their average, which the gauge measures, while
the wave of Fig. 4(b) passes bead 5. (c) β of Eq. (6) against the contact force F_m (static part F_0 included): exact
travelling wave, by similarity the same for any modulus, and strikes on 60 beads.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.patches import Rectangle, Wedge

from drivers.engines import REFERENCE
from postproc.draw.plot import AVERAGE, COLUMN_IN, FIRST, GREY, MICRO, SECOND, Product, draw_codes, letter_panel, pyplot
from postproc.paper import strikes
from postproc.read.motion import UNTIL_REFLECTED, case_of, simulate
from postproc.read.signals import sensor_average
from validation.reference.travelling_wave import solve_at_speed, solve_travelling_wave

CURVE = np.geomspace(1.1, 1.1e4, 31)  # F_m / F_0 that the travelling waves have by Eq. (4), and to a few per cent
WAVE = "travelling wave"
STRIKES = (2.0, 10.0, 100.0, 1e3, 1e4)  # of the simulations
CHAIN = ("chain.count=60", "chain.sensors=[{ from_wall = 20 }, { from_wall = 10 }]", "gravity=")
STEADY_CHANGE = 1e-3  # largest relative change of a solitary wave's amplitude between the sensors
ARROW = {"arrowstyle": "-|>"}
SENSOR = 5  # bead of Fig. 4's chain shown in (b)
HALF_RANGE_S = 90e-6  # of (b), around the peak
FORCES = {"F1_N": FIRST, "F2_N": SECOND, "average_N": AVERAGE}


def make(runs: Path) -> Product:
    """Runs Fig. 4's scene for (b) and strikes on a precompressed chain for (c)."""
    size, shares = (COLUMN_IN, 6.3), [0.8, 1.25, 1.4]
    figure, axes = pyplot().subplots(3, 1, figsize=size, height_ratios=shares, layout="constrained")
    _draw_free_body(axes[0])
    forces, waves, points = _forces(runs), _waves(), _points(runs)
    _draw_forces(axes[1], forces)
    _draw_beta(axes[2], waves, points)
    for axis, letter in zip(axes, "abc", strict=True):
        letter_panel(axis, letter)
    return Product(figure, pd.concat([forces, waves, points], ignore_index=True))


def _chain() -> tuple[str, ...]:
    """Settings of the precompressed chain, with the static force of Table 1 between the sensors."""
    return (*CHAIN, f"chain.precompression={strikes.static_force(case_of('table1'))!r} N")


def _draw_free_body(axis: Any) -> None:
    """Draws caps of mass M, the gauge of mass m between them, contact forces, and F_3 and F_4 on the gauge's faces."""
    axis.set(xlim=(-3.0, 3.0), ylim=(-1.1, 1.1), aspect="equal")
    axis.axis("off")
    for side, outer, inner in ((-1, "$F_1$", "$F_3$"), (1, "$F_2$", "$F_4$")):
        centre = 0.12 * side
        cap = Wedge((centre, 0), 1, -90 * side, -90 * side + 180, facecolor="#f2f2f2", edgecolor="black", lw=0.8)
        axis.add_patch(cap)
        axis.text(centre + 0.45 * side, 0.2, "$M$", ha="center", va="center")
        axis.annotate("", (centre + side, 0), (centre + 2.1 * side, 0), arrowprops=ARROW)
        axis.text(centre + 1.8 * side, 0.14, outer, ha="center")
        axis.annotate("", (0.14 * side, -0.5), (0.75 * side, -0.5), arrowprops=ARROW)
        axis.text(0.6 * side, -0.45, inner, color="black", ha="center", va="bottom")
    axis.add_patch(Rectangle((-0.12, -0.85), 0.24, 1.7, facecolor="#e69f00", edgecolor="black", lw=0.8))
    axis.annotate("$m$", (0, 0.85), (0, 0.98), ha="center", va="bottom", annotation_clip=False)


def _forces(runs: Path) -> pd.DataFrame:
    """Contact forces of the sensor bead and their average by every engine, around the time of the wave."""
    (simulations,) = simulate([case_of("fig4", UNTIL_REFLECTED)], runs)
    time_s = simulations[REFERENCE].trace.time_s
    near = np.abs(time_s - simulations[REFERENCE].values[f"bead_{SENSOR}_arrival_s"]) < HALF_RANGE_S
    tables = []
    for engine, simulation in simulations.items():
        force_N = simulation.trace.force_N[near]
        above, below, average = force_N[:, SENSOR], force_N[:, SENSOR - 1], sensor_average(force_N, SENSOR)
        forces = dict(zip(FORCES, (above, below, average), strict=True))
        tables.append(pd.DataFrame({"panel": "b", "engine": engine, "time_s": time_s[near]} | forces))
    return pd.concat(tables, ignore_index=True)


def _draw_forces(axis: Any, forces: pd.DataFrame) -> None:
    """Draws labelled lines of the reference, and markers of the codes at the maxima."""
    exact = forces[forces["engine"] == REFERENCE]
    time_us = exact["time_s"].to_numpy() * MICRO
    for name, look in FORCES.items():
        axis.plot(time_us, exact[name], **look)
    axis.set(xlabel="time since impact (µs)", ylabel="force (N)", ylim=(-0.4, 1.35 * float(exact["F1_N"].max())))
    average = exact["average_N"].to_numpy()
    rise, *_, fall = np.flatnonzero(average > 0.3 * average.max())
    seen = [int(rise), int(average.argmax()), int(fall)]
    at_maxima = {str(code): some.iloc[seen] for code, some in forces.groupby("engine") if code != REFERENCE}
    draw_codes(axis, {code: (some["time_s"] * MICRO, some["average_N"]) for code, some in at_maxima.items()})
    look = {"textcoords": "offset points", "ha": "right"}
    for name, label, aside in (("F1_N", "$F_1$", -4), ("F2_N", "$F_2$", 14)):
        top = int(np.argmax(exact[name]))
        axis.annotate(label, (time_us[top], exact[name].iloc[top]), (aside, 2), **look)
    axis.annotate(r"$(F_1 + F_2)/2$", (time_us[rise], average[rise]), (-8, 8), **look)
    axis.legend(loc="upper right", handlelength=1.0)


def _waves() -> pd.DataFrame:
    """Beta of the travelling wave."""
    case = case_of("table1", *_chain())
    chain, particles = case.chain, strikes.particles_of(case)
    stiffness, mass, static = float(chain.stiffness[1]), float(chain.mass_kg[0]), case.scene.chain.precompression
    speeds = [strikes.precompressed_speed(particles, ratio * static, static) / particles.diameter_m for ratio in CURVE]
    waves = [solve_at_speed(stiffness, mass, static, beads_per_s) for beads_per_s in speeds]
    rows = [{"force_over_static": 1 + wave.amplitude, "beta": wave.beta, "engine": WAVE} for wave in waves]
    limit = solve_travelling_wave().contact_over_average
    bare = pd.DataFrame({"force_over_static": CURVE[[0, -1]], "beta": limit, "engine": f"{WAVE} without static force"})
    return pd.concat([pd.DataFrame(rows), bare]).assign(panel="c")


def _points(runs: Path) -> pd.DataFrame:
    """Beta from full simulations by every engine."""
    chain, rows = _chain(), []
    static = strikes.static_force(case_of("table1", *chain))
    cases = [strikes.strike_for(ratio * static, strikes.contact_peak, *chain).case for ratio in STRIKES]
    for simulations in simulate(cases, runs):
        for engine, simulation in simulations.items():
            peak, places = strikes.contact_peak(simulation), strikes.sensor_pair(simulation.case)
            upper, lower = (simulation.values[f"bead_{bead}_amplitude_N"] for bead in places)
            rows.append({
                "panel": "c", "engine": engine, "force_over_static": peak / static,
                "beta": (peak - static) / strikes.sensor_amplitude(simulation),
                "change_between_sensors": lower / upper - 1, "solitary": abs(lower / upper - 1) < STEADY_CHANGE,
            })  # fmt: skip
    return pd.DataFrame(rows)


def _draw_beta(axis: Any, waves: pd.DataFrame, points: pd.DataFrame) -> None:
    """Draws the travelling wave and the codes' strikes.

    A pulse whose amplitude changes by more than ``STEADY_CHANGE`` over ten beads is not yet a solitary wave.
    """
    limit, waves = (waves[(waves["engine"] == WAVE) == pressed] for pressed in (False, True))
    axis.plot(limit["force_over_static"], limit["beta"], color=GREY, lw=0.8, ls=(0, (4, 3)))
    axis.plot(waves["force_over_static"], waves["beta"], **AVERAGE)
    axis.set(xscale="log", xlabel=r"$F_m\,/\,F_0$", ylabel=r"$\beta$", xlim=(1, 1.6e4), ylim=(1.0, 1.45))
    axis.text(1.1, limit["beta"].iloc[0], f"no static force: {limit['beta'].iloc[0]:.3f}", color=GREY, va="bottom")
    axis.text(40, 1.27, "exact travelling wave")
    by_code = {str(code): some for code, some in points.groupby("engine") if code != REFERENCE}
    draw_codes(axis, {code: (some["force_over_static"], some["beta"]) for code, some in by_code.items()})
    early = points[~points["solitary"]].iloc[0]
    place = early["force_over_static"], early["beta"]
    axis.annotate("not yet solitary", place, (6, -3), textcoords="offset points", color=GREY)
