"""Fig. 2: forces on a sensor bead and coefficient β.

(a) Forces on the parts of the particle: F_1 and F_2 on its contacts, F_3 and F_4 on the faces of the gauge of mass m
between two caps of mass M. (b) Forces against time in the solitary wave that passes bead 5 of the chain of Fig. 4 (E =
1.46 GPa): contact above (F_1, dashed), contact below (F_2, dash-dotted) and their average (solid), which the gauge
measures. (c) Coefficient β of Eq. (6), the peak of the dynamic contact force over the peak of the dynamic average,
against the amplitude F_m (static part included) over the static force F_0. Solid line: exact travelling wave of the
discrete chain; dashed line: its limit without static force. For linear waves β is 1. Lines in (b) and (c) are computed
by the reference, grey markers by the codes. The markers of (c) are strikes on 60 beads under the static force of Table
1 with E = 600, 1000 and 1460 MPa, which coincide. Pale markers are pulses whose amplitude still changes by more than
0.1 % over ten beads: they are not yet solitary waves. The paper prints these panels without numbers to compare with.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.patches import Rectangle, Wedge

from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.style import (
    AVERAGE,
    COLUMN_IN,
    FIRST,
    GREY,
    MICRO,
    SECOND,
    drawing_order,
    grey_of,
    letter_panel,
    pyplot,
)
from postproc.paper.quoted import quoted
from postproc.paper.simulate import UNTIL_REFLECTED, case_of, simulate
from postproc.paper.strikes import contact_peak, sensor_amplitude, sensor_pair, static_force, strike_for
from postproc.read.sensors import sensor_average
from validation.reference.travelling_wave import solve_at_amplitude, solve_travelling_wave

CURVE = np.geomspace(1.1, 1e4, 31)  # F_m / F_0 of the travelling waves
STRIKES = (2.0, 10.0, 100.0, 1e3, 1e4)  # of the simulations
CHAIN = ("chain.count=60", "chain.sensors=[{ from_wall = 20 }, { from_wall = 10 }]", "gravity=")
STEADY_CHANGE = 1e-3  # largest relative change of a solitary wave's amplitude between the sensors
ARROW = {"arrowstyle": "-|>"}
SENSOR = 5  # bead of Fig. 4's chain shown in (b)
HALF_RANGE_S = 90e-6  # of (b), around the peak
MARKER_INTERVAL = 27  # samples between the markers of a code
FORCES = {"F1_N": FIRST, "F2_N": SECOND, "average_N": AVERAGE}
PALE_ALPHA = 0.15  # three markers overlap


def make(runs: Path) -> Product:
    """Runs Fig. 4's scene for (b) and strikes on a precompressed chain for (c)."""
    figure, axes = pyplot().subplots(
        3, 1, figsize=(COLUMN_IN, 6.3), height_ratios=[0.8, 1.25, 1.4], layout="constrained"
    )
    _draw_free_body(axes[0])
    forces, waves, points = _forces(runs), _waves(), _points(runs)
    _draw_forces(axes[1], forces)
    _draw_beta(axes[2], waves, points)
    for axis, letter in zip(axes, "abc", strict=True):
        letter_panel(axis, letter)
    # dependence on the modulus: (largest - smallest) / mean over the moduli, by engine and amplitude
    both = pd.concat([waves, points], ignore_index=True)
    both["force_over_static"] = both["force_over_static"].map(lambda value: float(f"{value:.3g}"))
    beta = both.groupby(["engine", "force_over_static"], sort=False)["beta"]
    spread = ((beta.max() - beta.min()) / beta.mean()).reset_index(name="beta_spread_over_moduli_share")
    tables = [forces, waves, points, spread.assign(panel="c, all moduli")]
    return Product(figure, pd.concat(tables, ignore_index=True))


def _chains() -> dict[float, tuple[str, ...]]:
    """Settings of the precompressed chain by modulus in MPa, with the static force of Table 1 between the sensors."""
    pressed = (*CHAIN, f"chain.precompression={static_force(case_of('table1'))!r} N")
    return {modulus: (*pressed, f"materials.ptfe.youngs_modulus={modulus} MPa") for modulus in quoted().ptfe_moduli_MPa}


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
    (found,) = simulate([case_of("fig4", UNTIL_REFLECTED)], runs)
    time_s = found[REFERENCE].trace.time_s
    near = np.abs(time_s - found[REFERENCE].values[f"bead_{SENSOR}_arrival_s"]) < HALF_RANGE_S
    tables = []
    for engine, one in found.items():
        force_N = one.trace.force_N[near]
        above, below, average = force_N[:, SENSOR], force_N[:, SENSOR - 1], sensor_average(force_N, SENSOR)
        columns = {"panel": "b", "engine": engine, "time_s": time_s[near]}
        tables.append(pd.DataFrame(columns | dict(zip(FORCES, (above, below, average), strict=True))))
    return pd.concat(tables, ignore_index=True)


def _draw_forces(axis: Any, forces: pd.DataFrame) -> None:
    """Draws labelled lines of the reference, and markers of the codes at staggered samples."""
    exact = forces[forces["engine"] == REFERENCE]
    time_us = exact["time_s"].to_numpy() * MICRO
    for name, look in FORCES.items():
        axis.plot(time_us, exact[name], **look)
    codes = drawing_order([str(name) for name in forces["engine"].unique() if name != REFERENCE])
    for place, code in enumerate(codes):
        own = forces[forces["engine"] == code].iloc[place * MARKER_INTERVAL // len(codes) :: MARKER_INTERVAL]
        for name in FORCES:
            drawn = axis.plot(own["time_s"] * MICRO, own[name], **grey_of(code))
        drawn[0].set_label(code)
    for name, label, side in (("F1_N", "$F_1$", -1), ("F2_N", "$F_2$", 1)):
        top = int(np.argmax(exact[name]))
        axis.annotate(label, (time_us[top], exact[name].iloc[top]), xytext=(9 * side, 2), textcoords="offset points",
                      ha="center", va="bottom")  # fmt: skip
    rise = int(np.argmax(exact["average_N"] > 0.3 * exact["average_N"].max()))
    axis.annotate(r"$(F_1 + F_2)/2$", (time_us[rise], exact["average_N"].iloc[rise]), xytext=(-24, 8), ha="right",
                  textcoords="offset points", arrowprops={"arrowstyle": "-", "lw": 0.5, "shrinkB": 0})  # fmt: skip
    axis.set(xlabel="time since impact (µs)", ylabel="force (N)", ylim=(-0.4, 1.18 * float(exact["F1_N"].max())))
    axis.legend(loc="upper right", handlelength=1.0)


def _waves() -> pd.DataFrame:
    """Beta of the travelling wave for each modulus, computed in SI units, so that equal values are a result."""
    tables = []
    for modulus, settings in _chains().items():
        chain = case_of("table1", *settings).chain
        stiffness, mass, static = float(chain.stiffness[1]), float(chain.mass_kg[0]), chain.precompression_N
        beta = [solve_at_amplitude(stiffness, mass, static, ratio - 1).beta for ratio in CURVE]
        columns = {"panel": "c", "engine": "travelling wave", "modulus_MPa": modulus}
        tables.append(pd.DataFrame(columns | {"force_over_static": CURVE, "beta": beta}))
    limit = {"panel": "c", "engine": "travelling wave without static force"}
    ends = pd.DataFrame({"force_over_static": CURVE[[0, -1]], "beta": solve_travelling_wave().contact_over_average})
    return pd.concat([*tables, ends.assign(**limit)], ignore_index=True)


def _points(runs: Path) -> pd.DataFrame:
    """Beta from full simulations by every engine."""
    cases = {}
    for modulus, settings in _chains().items():
        static = static_force(case_of("table1", *settings))
        for ratio in STRIKES:
            cases[modulus, ratio] = strike_for(ratio * static, contact_peak, *settings).case
    rows, found = [], simulate(list(cases.values()), runs)
    for engine in found[0]:
        for (modulus, _), by_engine in zip(cases, found, strict=True):
            one = by_engine[engine]
            upper, lower = (one.values[f"bead_{bead}_amplitude_N"] for bead in sensor_pair(one.case))
            peak, static = contact_peak(one), static_force(one.case)
            rows.append({
                "panel": "c", "engine": engine, "modulus_MPa": modulus, "force_over_static": peak / static,
                "beta": (peak - static) / sensor_amplitude(one), "change_between_sensors": lower / upper - 1,
                "solitary": abs(lower / upper - 1) < STEADY_CHANGE,
            })  # fmt: skip
    return pd.DataFrame(rows)


def _draw_beta(axis: Any, waves: pd.DataFrame, points: pd.DataFrame) -> None:
    """Draws one line, since those of all moduli coincide, and the codes' strikes on the chains of all moduli."""
    limit = waves[waves["modulus_MPa"].isna()]
    first = waves[waves["modulus_MPa"] == waves["modulus_MPa"].min()]
    axis.plot(limit["force_over_static"], limit["beta"], color=GREY, lw=0.8, ls=(0, (4, 3)))
    axis.plot(first["force_over_static"], first["beta"], **AVERAGE)
    for code in drawing_order([str(name) for name in points["engine"].unique() if name != REFERENCE]):
        own = points[points["engine"] == code]
        for solitary in (True, False):
            some = own[own["solitary"] == solitary]
            axis.plot(some["force_over_static"], some["beta"], alpha=1.0 if solitary else PALE_ALPHA, **grey_of(code))
    axis.set(xscale="log", xlabel=r"$F_m\,/\,F_0$", ylabel=r"$\beta$", xlim=(1, 1.6e4), ylim=(1.0, 1.45))
