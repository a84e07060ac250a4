"""Figure, table and lines of the linear modes of a scene: dispersion of its pattern, frequencies, shapes."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd

from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from postproc.draw.product import Product
from postproc.draw.style import GREY, PAGE_IN, letter_panel, pyplot
from postproc.linear.modes import (
    SOFTENING,
    Bands,
    Modes,
    bands_of,
    modes_of,
    overlap_ratio,
    sound_speed_m_s,
    springs_N_m,
    static_forces_N,
)

MAX_WORK = 20_000_000  # bodies times steps of the motion whose overlaps are compared with the static ones
SMALL_RATIO = 0.1  # largest change of an overlap, divided by the static one, up to which a motion is called linear
SHAPES = 3  # lowest modes that are drawn, with the highest one
LINES = 8  # modes that are printed
BAND = "#dcebf5"


def modes_product(case: Case) -> Product:
    """Figure and table of the modes of a scene, with the lines to print.

    Raises:
        ValueError: no contact has a load, no bead is free, or beads move sideways.
    """
    chain = case.chain
    if not chain.straight:
        raise ValueError("beads that move sideways: modes are those of straight chains")
    if chain.beads == 1 and chain.drive is not None and chain.drive.prescribed:
        raise ValueError("the only bead moves as prescribed: there is no mode")
    if not springs_N_m(chain).any():
        raise ValueError("no contact has a static load: without gravity or precompression there are no linear waves")
    modes = modes_of(chain)
    bands, remark = _bands(case)
    figure, (left, middle, right) = pyplot().subplots(
        1, 3, figsize=(PAGE_IN, 3.0), layout="constrained", width_ratios=(1, 1, 1)
    )
    _draw_dispersion(left, bands)
    _draw_frequencies(middle, modes, bands)
    _draw_shapes(right, modes)
    lines = [*_lines(case, modes, bands), *([remark] if remark else []), *_end_of_linear_theory(case)]
    return Product(figure, _table(modes, bands), notes=lines)


def _bands(case: Case) -> tuple[list[Bands], str]:
    """Bands at the smallest and the largest static force of the contacts between beads; and why there are none."""
    held = static_forces_N(case.chain)[1:]
    held = held[held > 0]
    if not held.size:
        return [], ""
    forces = sorted({float(held.min()), float(held.max())})
    try:
        return [bands_of(case, force) for force in forces], ""
    except ValueError as error:
        return [], f"no bands: {error}"


def _table(modes: Modes, bands: list[Bands]) -> pd.DataFrame:
    beads, count = modes.shape.shape
    table = pd.DataFrame({
        "what": "mode", "mode": np.arange(1, count + 1), "frequency_Hz": modes.frequency_Hz,
        "participation_beads": modes.participation,
    })  # fmt: skip
    if beads <= 200:
        shapes = pd.DataFrame(modes.shape.T, columns=[f"body_{body}" for body in range(1, beads + 1)])
        table = pd.concat([table, shapes], axis=1)
    rows = [
        pd.DataFrame({
            "what": "dispersion", "static_force_N": at_force.force_N, "band": band + 1, "phase_rad": at_force.phase,
            "frequency_Hz": at_force.frequency_Hz[:, band], "group_velocity_m_s": at_force.group_velocity_m_s[:, band],
        })
        for at_force in bands
        for band in range(at_force.frequency_Hz.shape[1])
    ]  # fmt: skip
    return pd.concat([table, *rows], ignore_index=True)


def _lines(case: Case, modes: Modes, bands: list[Bands]) -> Iterator[str]:
    chain, members = case.chain, len(case.scene.chain.members)
    forces = static_forces_N(chain)
    yield f"static force of the contacts: {forces.min():.4g} to {forces.max():.4g} N"
    if chain.beads > 1:
        speed = sound_speed_m_s(chain, 1, chain.beads, members)
        yield f"static sound speed, mean of the chain: {speed:.5g} m/s"
    for band in bands:
        edges = ", ".join(f"{low:.5g} to {high:.5g} Hz" for low, high in band.edges_Hz)
        yield f"bands at {band.force_N:.4g} N: {edges}; long waves {band.sound_speed_m_s:.5g} m/s"
    count = len(modes.frequency_Hz)
    for place in [*range(min(LINES, count)), *range(max(LINES, count - LINES), count)]:
        localised = f", {modes.participation[place]:.3g} beads move" if modes.participation[place] < 3 else ""
        yield f"mode {place + 1}: {modes.frequency_Hz[place]:.6g} Hz{localised}"


def _end_of_linear_theory(case: Case) -> Iterator[str]:
    """Line on the motion of the scene: its changes of overlaps against the static ones."""
    if not case.chain.straight or case.work > MAX_WORK:
        yield f"motion not compared with linear theory: more than {MAX_WORK:g} bodies times steps, or three dimensions"
        return
    ratio = overlap_ratio(case, verlet_of(case).force_N)
    place = int(np.argmax(ratio))
    largest = float(ratio[place])
    words = f"the motion of the scene changes the overlap of contact {place + 1} by {largest:.3g} of the static overlap"
    if largest <= SMALL_RATIO:
        yield f"linear: {words}; frequencies change by about {SOFTENING * largest**2:.1g}"
    else:
        yield f"not linear: {words}, linear theory holds far below 1"


def _draw_dispersion(axis: Any, bands: list[Bands]) -> None:
    letter_panel(axis, "a")
    for at_force, dashes in zip(bands, ("-", "--"), strict=False):
        lines = axis.plot(at_force.phase / np.pi, at_force.frequency_Hz / 1e3, dashes, color="#0072b2")
        lines[0].set_label(f"{at_force.force_N:.3g} N")
    axis.set(xlabel="phase per cell / π", ylabel="frequency (kHz)", xlim=(0, 1), ylim=(0, None))
    if bands:
        axis.legend(title="static force", frameon=False)
    else:
        axis.text(0.5, 0.5, "no bands", ha="center", transform=axis.transAxes, color=GREY)


def _draw_frequencies(axis: Any, modes: Modes, bands: list[Bands]) -> None:
    letter_panel(axis, "b")
    shade_bands(axis.axhspan, bands)
    number = np.arange(1, len(modes.frequency_Hz) + 1)
    localised = modes.participation < 3
    axis.plot(number[~localised], modes.frequency_Hz[~localised] / 1e3, ".", color="#0072b2", ms=4)
    axis.plot(number[localised], modes.frequency_Hz[localised] / 1e3, "x", color="#d55e00", ms=5, label="localised")
    axis.set(xlabel="mode", ylim=(0, None))
    if localised.any():
        axis.legend(frameon=False, loc="lower right")


def shade_bands(span: Any, bands: list[Bands], unit_Hz: float = 1e3) -> None:
    """Shades the bands at the largest static force by ``axhspan`` or ``axvspan``."""
    for low, high in bands[-1].edges_Hz if bands else ():
        span(low / unit_Hz, high / unit_Hz, color=BAND, lw=0)


def _draw_shapes(axis: Any, modes: Modes) -> None:
    letter_panel(axis, "c")
    beads, count = modes.shape.shape
    places = sorted({*range(min(SHAPES, count)), count - 1})
    for row, place in enumerate(places):
        level = 2.5 * row
        axis.axhline(level, color=GREY, lw=0.4)
        axis.plot(np.arange(1, beads + 1), level + modes.shape[:, place], ".-", color="#0072b2", ms=3, lw=0.8)
        axis.text(1.02, level, f"{place + 1}", va="center", color=GREY, transform=axis.get_yaxis_transform())
    axis.set(xlabel="bead, from the wall", ylabel="displacement of modes", yticks=[])
