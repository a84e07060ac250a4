"""Fig. 3: speed against amplitude, with scores of the moduli.

Of a solitary wave, by Eqs. (3) and (4), discrete chains and the experiment.

Every number of a discrete chain is a full simulation of a strike: the speed from sensor to sensor, the amplitude
the mean peak of the contact forces between them, static part included (F_m of Eq. 6). The curves' numbers are the
paper's: 1 to 4 for 600 MPa, 5 to 8 for 1460 MPa, in the order Eq. (3), simulated, Eq. (4), simulated with gravity.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.style import COLUMN_IN, FAINT, draw_table, drawing_order, line_of, marker_of, pyplot
from postproc.paper import strikes
from postproc.paper.quoted import quoted
from postproc.paper.simulate import Simulation, case_of, run_codes_on
from postproc.paper.theory import particles_of, precompressed_speed, speed_from_force

FORCES_N = np.geomspace(0.03, 20, 13)
BY_CODES = slice(0, 13, 4)  # the amplitudes that the codes run as well
PRINTED = {600.0: 1, 1460.0: 5}  # number of a modulus' first curve in the paper
XLIM_N = (0.011, 70)
LARGE_N = 2.0  # amplitudes from here on are the large ones of the table


class Curve(NamedTuple):
    """One modulus with or without gravity."""

    modulus_MPa: float
    gravity: bool

    @property
    def settings(self) -> tuple[str, ...]:
        """What it changes in the scene of Table 1."""
        modulus = f"materials.ptfe.youngs_modulus={self.modulus_MPa} MPa"
        return (modulus,) if self.gravity else (modulus, "gravity=")

    @property
    def number(self) -> float:
        """That of its theory in the paper's figure, NaN if it is not there; that of its simulations is the next."""
        return PRINTED.get(self.modulus_MPa, np.nan) + 2 * self.gravity


def make(runs: Path) -> Product:
    """Runs the strikes and draws them over the theory, with the codes' differences and the scores below.

    Beside it the chain under the weakest and the strongest strike, by the reference: the stiffest beads, with gravity.
    """
    curves = [Curve(modulus, gravity) for modulus in quoted().ptfe.moduli_MPa for gravity in (False, True)]
    exact = {
        curve: [strikes.strike_for(force, strikes.contact_peak, *curve.settings) for force in FORCES_N]
        for curve in curves
    }
    points = _points(exact, runs)
    theory = _theory(curves, points)
    experiment, score = strikes.measured_points(), strikes.scores()
    figure, axes = pyplot().subplots(3, 1, figsize=(COLUMN_IN, 7.0), height_ratios=[3.4, 0.9, 1.5])
    _draw_speeds(axes[0], points, theory, experiment)
    by_strike = points[points["engine"] == REFERENCE].set_index("striker_m_s")["speed_m_s"]
    for engine in drawing_order([str(name) for name in points["engine"].unique() if name != REFERENCE]):
        own = points[points["engine"] == engine]
        share = own["speed_m_s"].to_numpy() / by_strike.loc[own["striker_m_s"]].to_numpy() - 1
        axes[1].plot(own["force_N"], 1e6 * share, ls="", **marker_of(engine))
    axes[1].set(xscale="log", xlim=XLIM_N, xlabel=r"$F_m$ (N)", ylabel=r"$10^6\,\Delta V_s/V_s$")
    axes[1].set_title("speed by the codes less that by the reference, same strike", loc="left")
    rows = []
    for (reading, modulus), some in score.groupby(["force_read_as", "modulus_MPa"]):
        large = some["force_N"] >= LARGE_N
        rms = (np.sqrt((some["deviation_standard_errors"][which] ** 2).mean()) for which in (large, ~large))
        deviations = (f"{value:+.0f}" for value in some["deviation_pct"])
        rows.append([str(reading).split()[0], f"{modulus:g}", *deviations, *(f"{value:.1f}" for value in rms)])
    forces = [f"{force:g} N" for force in score["force_N"].unique()]
    headings = ["$F_m$ as", "MPa", *forces, f"≥ {LARGE_N:g} N", f"< {LARGE_N:g} N"]
    widths = [0.14, 0.1, *([0.105] * len(forces)), 0.12, 0.12]
    draw_table(axes[2], rows, headings, 6.5, bbox=[0, 0, 1, 0.88], colWidths=widths)
    title = "measured off simulated speed, %; right: rms in standard errors"
    axes[2].set_title(title, loc="left", fontsize=7, y=0.92)
    figure.subplots_adjust(hspace=0.45)
    tables = [points, theory, experiment.assign(source="experiment"), score.assign(source="score")]
    stiffest = max(curves)
    title = f"{stiffest.modulus_MPa:g} MPa, with gravity ({REFERENCE})"
    chains = {f"{FORCES_N[i]:g} N, {title}": exact[stiffest][i].trace for i in (0, -1)}
    return Product(figure, pd.concat(tables, ignore_index=True), chains)


def _points(exact: dict[Curve, list[Simulation]], runs: Path) -> pd.DataFrame:
    """A row per strike and engine."""
    chosen = [(curve, simulation.case) for curve, some in exact.items() for simulation in some[BY_CODES]]
    found = [
        (curve, one)
        for simulations in run_codes_on([case for _, case in chosen], runs).values()
        for (curve, _), one in zip(chosen, simulations, strict=True)
    ]
    found += [(curve, one) for curve, some in exact.items() for one in some]
    return pd.DataFrame([
        {
            "source": "simulated", "engine": one.engine, "curve": curve.number + 1,
            "modulus_MPa": curve.modulus_MPa, "gravity": curve.gravity, "striker_m_s": strikes.striker_speed(one),
            "force_N": strikes.contact_peak(one), "static_N": strikes.static_force(one.case),
            "sensor_amplitude_N": strikes.sensor_amplitude(one), "speed_m_s": strikes.speed_between_sensors(one),
        }
        for curve, one in found
    ])  # fmt: skip


def _theory(curves: list[Curve], points: pd.DataFrame) -> pd.DataFrame:
    """Eqs. (3) and (4) at the same amplitudes; the static force of Eq. (4) is that between the sensors."""
    static = float(points.loc[points["gravity"], "static_N"].iloc[0])
    rows = []
    for curve in curves:
        particles = particles_of(case_of("table1", *curve.settings))
        for force in FORCES_N:
            bare, pressed = speed_from_force(particles, force), precompressed_speed(particles, force, static)
            source, static_N, speed = ("Eq. (4)", static, pressed) if curve.gravity else ("Eq. (3)", 0.0, bare)
            rows.append((source, curve.number, *curve, force, static_N, speed))
    names = ("source", "curve", "modulus_MPa", "gravity", "force_N", "static_N", "speed_m_s")
    return pd.DataFrame(rows, columns=names)


def _draw_speeds(axis: Any, points: pd.DataFrame, theory: pd.DataFrame, experiment: pd.DataFrame) -> None:
    for modulus in PRINTED:
        for source, dashes in (("Eq. (3)", (0, (4, 2))), ("Eq. (4)", (0, (1, 1)))):
            own = theory[(theory["modulus_MPa"] == modulus) & (theory["source"] == source)]
            label = source if modulus == min(PRINTED) else None
            axis.plot(own["force_N"], own["speed_m_s"], color="black", lw=0.9, ls=dashes, label=label)
    for _, own in points[points["engine"] == REFERENCE].groupby(["modulus_MPa", "gravity"]):
        axis.plot(own["force_N"], own["speed_m_s"], color=line_of(REFERENCE).colour, lw=0.8)
    for engine in drawing_order(list(points["engine"].unique())):
        own = points[points["engine"] == engine]
        look = marker_of(engine) | ({"ms": 4.5} if engine == REFERENCE else {"ms": 2.6, "mew": 0.8})
        axis.plot(own["force_N"], own["speed_m_s"], ls="", label=engine, **look)
    for modulus in quoted().ptfe.moduli_MPa:
        own = points[(points["engine"] == REFERENCE) & (points["modulus_MPa"] == modulus)]
        end, look = own[~own["gravity"]].iloc[-1], {"textcoords": "offset points"}
        axis.annotate(f"{modulus:g} MPa", (end["force_N"], end["speed_m_s"]), (7, -2), **look)
        for gravity in (False, True) if modulus in PRINTED else ():
            start, number = own[own["gravity"] == gravity].iloc[0], PRINTED[modulus] + 2 * gravity
            place = start["force_N"], start["speed_m_s"]
            axis.annotate(f"{number}, {number + 1}", place, (-5, -3), ha="right", color=FAINT, **look)
    dots: dict[str, Any] = {"fmt": "o", "color": "black", "ms": 3.5, "zorder": 5, "capsize": 1.5}
    axis.errorbar(experiment["force_N"], experiment["speed_m_s"], xerr=experiment["force_error_N"],
                  yerr=experiment["speed_error_m_s"], elinewidth=0.7, label="experiment", **dots)  # fmt: skip
    axis.errorbar(experiment["force_N"], experiment["speed_m_s"], yerr=experiment["speed_error_by_position_m_s"],
                  elinewidth=2, **(dots | {"capsize": 0}))  # fmt: skip
    ticks = (50, 70, 100, 150, 200)
    axis.set(xscale="log", yscale="log", xlabel=r"$F_m$ (N)", ylabel=r"$V_s$ (m/s)", xlim=XLIM_N, ylim=(45, 330))
    axis.set_yticks(ticks, [str(tick) for tick in ticks])
    axis.minorticks_off()
    axis.legend(loc="upper left", columnspacing=1, handlelength=1.6, labelspacing=0.3)
