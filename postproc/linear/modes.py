"""Small motions of a chain about its static equilibrium: modes, bands and gaps of its pattern, and their figure.

Each loaded contact is a spring ``K = (3/2) k d^(1/2) = (3/2) k^(2/3) F^(1/3)`` (Nesterenko, Dynamics of Heterogeneous
Materials, chapter 1), each open contact none. The striker and a body that moves as prescribed are not part of it.

A pattern of p members, repeated without end at one static force, has p bands: the frequencies of Bloch waves, whose
displacements ``u_{j+p} = u_j exp(i q)`` have a phase q per cell from 0 to pi. Long waves travel at the static sound
speed ``c = a / sqrt(M C)``, with the length a and the mass M of a cell and the sum C of its compliances 1/K.

Between the bands and above them q is complex, and amplitudes fall by ``exp(-Im q)`` per cell. The matrix T that takes
displacement and force across a cell has the determinant 1, so ``2 cos q = trace T`` and ``cosh(Im q) = |trace T| / 2``
(Brillouin, Wave Propagation in Periodic Structures, 1946).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import pi, sqrt
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, contact_stiffness, hertz_stiffness, ordinary_beads, stiffness_by
from drivers.chain.schemes import verlet_of
from postproc.draw.plot import GREY, PAGE_IN, Product, letter_panel, pyplot

MAX_BEADS = 5_000  # with modes; all shapes of 5,000 beads take 200 MB
PHASES = 101  # of the dispersion curve
GAP_POINTS = 51  # frequencies in each gap
SHOWN, ABOVE = 1.15, 1.5  # upper end of the drawn frequencies, and of those in the table, divided by the highest edge
# A contact that oscillates by r d about its overlap d is slower by r^2 / 24, by the Lindstedt method.
SOFTENING = 1 / 24
MAX_WORK = 20_000_000  # bodies times steps of the motion whose overlaps are compared with the static ones
SMALL_RATIO = 0.1  # largest change of an overlap, divided by the static one, up to which a motion is called linear
FEW = 3  # a mode is localised if fewer beads move, or if its frequency lies in a gap
EDGE = 1e-6  # of a frequency: modes nearer to the edge of a band belong to it
LINES = 8  # lowest modes that are printed, with all localised ones
SHAPES = 3  # lowest modes that are drawn, with the highest one
MOST_SHAPES = 200  # beads of the largest chain whose shapes are in the table
BLUE, RED, BAND = "#0072b2", "#d55e00", "#dcebf5"


@dataclass(frozen=True)
class Modes:
    """Modes of a chain by frequency.

    Attributes:
        frequency_Hz: shape (modes,).
        shape: displacements of the beads, the largest of each mode 1. Shape (beads, modes).
        participation: number of beads that move as much as the others, ``(sum e)^2 / sum e^2`` of the kinetic energies
            e of the beads; small for a localised mode. Shape (modes,).
    """

    frequency_Hz: Array
    shape: Array
    participation: Array


def springs_N_m(chain: Chain) -> Array:
    """Contact stiffness K of each contact between beads, or with the wall, at time 0. Shape (beads,)."""
    return contact_stiffness(chain.stiffness, np.maximum(chain.overlap_m, 0.0))[: chain.beads]


def modes_of(chain: Chain) -> Modes:
    """Modes of the beads of a chain, from the eigenvalues of its tridiagonal matrix.

    A bead that moves as prescribed is held: its displacement is 0, and there is one mode less.
    """
    from scipy.linalg import eigh_tridiagonal

    spring, mass = springs_N_m(chain), chain.mass_kg[: chain.beads]
    diagonal, coupling = (spring + np.append(spring[1:], 0.0)) / mass, -spring[1:] / np.sqrt(mass[1:] * mass[:-1])
    held = chain.drive.body if chain.drive is not None and chain.drive.prescribed else None
    if held is not None:
        coupling[max(held - 1, 0) : held + 1] = 0.0
        diagonal[held] = 4 * diagonal.max()  # above all modes, which stay below twice the largest element
    squared, vectors = (values[..., : None if held is None else -1] for values in eigh_tridiagonal(diagonal, coupling))
    energy = vectors**2
    shape = vectors / np.sqrt(mass)[:, np.newaxis]
    places = np.argmax(np.abs(shape), axis=0)
    shape = shape / np.take_along_axis(shape, places[np.newaxis], axis=0)
    return Modes(np.sqrt(np.maximum(squared, 0.0)) / (2 * pi), shape, 1 / (energy**2).sum(axis=0))


def _cell(case: Case, force_N: float) -> tuple[Array, Array, float]:
    """Masses and springs of a cell at a static force, each spring below its member, and the length of the cell in m.

    Its beads are those of the pattern: without single beads, masses of sensors and scatter.
    """
    table, members = case.scene.chain, len(case.scene.chain.members)
    scene = case.scene.model_copy(update={"chain": table.model_copy(update={"count": 2 * members})})
    materials, diameter, mass = ordinary_beads(scene)
    stiffness = stiffness_by(hertz_stiffness, scene, materials, diameter / 2)[members:]
    overlap = (force_N / stiffness) ** (2 / 3)
    return mass[members:], contact_stiffness(stiffness, overlap), float((diameter[members:] - overlap).sum())


def bands_of(case: Case, force_N: float) -> pd.DataFrame:
    """Bloch waves of the pattern of a scene, which is one bead without ``[[chain.pattern]]``, at a static force.

    Returns:
        A row for each band and phase, the lowest band first, with the group velocity ``d omega / d q`` times the
        length of a cell; the first one is the speed of long waves. Then a row for each frequency in a gap, from the
        edge of a band on, where band and group velocity are empty and the decay per cell is above zero.
    """
    mass, spring, length = _cell(case, force_N)
    members, phase = len(mass), np.linspace(0.0, pi, PHASES)
    # changes of lengths times roots of springs, by displacements times roots of masses: singular values are omega
    matrix = np.tile(np.diag(np.sqrt(spring / mass)).astype(complex), (PHASES, 1, 1))
    matrix[:, range(1, members), range(members - 1)] = -np.sqrt(spring[1:] / mass[:-1])
    across = np.sqrt(spring[0] / mass[-1]) * np.exp(-1j * phase)[:, np.newaxis]  # by the contact of two cells
    matrix[:, 0, -1:] -= across
    left, omega, right = np.linalg.svd(matrix)
    slope = (1j * across * np.conj(left[:, 0] * right[..., -1])).real  # first-order perturbation of singular values
    omega, group = omega[:, ::-1], length * slope[:, ::-1]
    omega[0, 0] = 0.0  # a cell that moves as a whole, up to rounding
    group[0, 0] = length / sqrt(float(mass.sum()) * float((1 / spring).sum()))
    bands = pd.DataFrame({
        "band": np.repeat(np.arange(1, members + 1), PHASES), "phase_rad": np.tile(phase, members),
        "frequency_Hz": omega.T.ravel() / (2 * pi), "group_velocity_m_s": group.T.ravel(), "decay_per_cell": 0.0,
    })  # fmt: skip
    low, high = edges_Hz(bands).T
    ends = np.column_stack([high, np.append(low[1:], ABOVE * high[-1])])
    ends = ends[ends[:, 1] > (1 + EDGE) * ends[:, 0]]  # bands of equal beads touch
    shares = np.sin(np.linspace(0, pi / 2, GAP_POINTS)) ** 2  # dense at the edges, where the decay grows as a root
    frequency = (ends[:, :1] + np.diff(ends) * shares).ravel()
    waves = bloch_phase(case, force_N, frequency)
    gaps = pd.DataFrame({"phase_rad": waves.real, "frequency_Hz": frequency, "decay_per_cell": waves.imag})
    table = pd.concat([bands, gaps], ignore_index=True).astype({"band": "Int64"})
    table.insert(0, "static_force_N", force_N)
    return table


def bloch_phase(case: Case, force_N: float, frequency_Hz: Array) -> NDArray[np.complex128]:
    """Phase q per cell of the pattern at a static force, 0 to pi, with the decay of amplitudes as imaginary part.

    The decay is 0 in a band. Shape as ``frequency_Hz``.
    """
    mass, spring, _ = _cell(case, force_N)
    squared, whole = (2 * pi * frequency_Hz) ** 2, np.eye(2)
    for m, K in zip(mass, spring, strict=True):
        step = np.empty((*frequency_Hz.shape, 2, 2))  # across the spring, then across the mass
        step[..., 0, :] = 1, 1 / K
        step[..., 1, 0], step[..., 1, 1] = -m * squared, 1 - m * squared / K
        whole = step @ whole
    q = np.arccos(np.trace(whole, axis1=-2, axis2=-1).astype(complex) / 2)
    return np.asarray(q.real + 1j * np.abs(q.imag))


def is_tapered(case: Case) -> bool:
    """True if the beads of a chain differ by a taper, so that it has no bands."""
    return bool(case.scene.chain.taper_at(case.chain.beads) != 1)


def edges_Hz(bands: pd.DataFrame) -> Array:
    """Lowest and highest frequency of each band. Shape (members, 2)."""
    return bands.groupby("band")["frequency_Hz"].agg(["min", "max"]).to_numpy()


def sound_speed_m_s(chain: Chain, lower: int, upper: int, members: int = 1) -> float:
    """Static sound speed between two beads, from the travel time of long waves, ``sqrt(M C)`` of each cell.

    Args:
        chain: the chain.
        lower: lower bead, counted from the wall.
        upper: upper bead.
        members: members of the pattern.

    Returns:
        Speed in m/s; NaN if a contact between the beads has no load.
    """
    spring = springs_N_m(chain)[lower:upper]
    if not spring.size or not spring.all():
        return float("nan")
    mass = (chain.mass_kg[lower - 1 : upper - 1] + chain.mass_kg[lower:upper]) / 2
    starts = range(0, spring.size, members)
    cells = np.add.reduceat(mass, starts) * np.add.reduceat(1 / spring, starts)
    return float((chain.height_m[upper - 1] - chain.height_m[lower - 1]) / np.sqrt(cells).sum())


def localised_modes(modes: Modes, bands: Sequence[pd.DataFrame]) -> NDArray[np.bool_]:
    """Modes in which fewer than ``FEW`` beads move, or with frequencies in a gap at all static forces. Shape (modes,).

    Args:
        modes: the modes.
        bands: bands at the smallest and the largest static force, between which those of all contacts lie.
    """
    few = modes.participation < FEW
    if not bands:
        return few
    low, high = edges_Hz(bands[0])[:, 0] * (1 - EDGE), edges_Hz(bands[-1])[:, 1] * (1 + EDGE)
    frequency = modes.frequency_Hz[:, np.newaxis]
    return np.asarray(few | ~((low <= frequency) & (frequency <= high)).any(axis=1))


def modes_product(case: Case) -> tuple[Product, pd.DataFrame | None]:
    """Figure and table of the modes of a scene, with the lines to print; and the table of its bands, if it has any.

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
    modes, bands = modes_of(chain), bands_at_loads(case)
    localised = localised_modes(modes, bands)
    figure, (left, middle, right) = pyplot().subplots(1, 3, figsize=(PAGE_IN, 3.0), layout="constrained")
    _draw_dispersion(left, bands)
    _draw_frequencies(middle, modes, bands, localised)
    _draw_shapes(right, modes)
    beads, count = modes.shape.shape
    columns = {"frequency_Hz": modes.frequency_Hz, "participation_beads": modes.participation}
    if beads <= MOST_SHAPES:
        columns |= {f"body_{body + 1}": modes.shape[body] for body in range(beads)}
    table = pd.DataFrame(columns, pd.RangeIndex(1, count + 1, name="mode")).reset_index()
    lines = [*_lines(case, modes, bands, localised), _end_of_linear_theory(case)]
    return Product(figure, table, notes=lines), pd.concat(bands) if bands else None


def bands_at_loads(case: Case) -> list[pd.DataFrame]:
    """Bands at the smallest and the largest static force of contacts between beads; none without load or with taper."""
    if is_tapered(case):
        return []
    forces = np.unique(case.chain.elastic_N[1 : case.chain.beads])
    forces = forces[forces > 0]
    return [bands_of(case, float(force)) for force in np.unique([*forces[:1], *forces[-1:]])]


def _lines(case: Case, modes: Modes, bands: list[pd.DataFrame], localised: NDArray[np.bool_]) -> Iterator[str]:
    chain, forces = case.chain, case.chain.elastic_N[: case.chain.beads]
    yield f"static force of the contacts: {forces.min():.4g} to {forces.max():.4g} N"
    if chain.beads > 1:
        speed = sound_speed_m_s(chain, 1, chain.beads, len(case.scene.chain.members))
        yield f"static sound speed, mean of the chain: {speed:.5g} m/s"
    driven_Hz = case.scene.drive.frequency if case.scene.drive else None
    for table in bands:
        force_N, sound = (float(table[column].iloc[0]) for column in ("static_force_N", "group_velocity_m_s"))
        edges = ", ".join(f"{low:.5g} to {high:.5g} Hz" for low, high in edges_Hz(table))
        yield f"bands at {force_N:.4g} N: {edges}; long waves {sound:.5g} m/s"
        decay = bloch_phase(case, force_N, np.array([driven_Hz])).imag[0] if driven_Hz else 0.0
        if decay:
            yield f"drive of {driven_Hz:.6g} Hz: in a gap at {force_N:.4g} N, decay {decay:.5g} per cell"
    lowest = np.arange(len(localised)) < LINES
    for place in np.flatnonzero(localised | lowest):
        words = f", localised: {modes.participation[place]:.3g} beads move" if localised[place] else ""
        yield f"mode {place + 1}: {modes.frequency_Hz[place]:.6g} Hz{words}"
    if is_tapered(case):
        yield "no bands: the chain is tapered"


def _end_of_linear_theory(case: Case) -> str:
    """Line on the motion of the scene: the largest change of an overlap, divided by the static overlap."""
    if case.work > MAX_WORK:
        return f"motion not compared with linear theory: more than {MAX_WORK:g} bodies times steps"
    beads = case.chain.beads
    force, static = verlet_of(case).force_N[:, :beads], case.chain.elastic_N[:beads]
    with np.errstate(divide="ignore", invalid="ignore"):
        changes = np.abs((np.maximum(force, 0.0) / static) ** (2 / 3) - 1).max(axis=0)
    place = int(np.argmax(ratio := np.where(static > 0, changes, np.inf)))  # infinite for a contact without load
    largest = float(ratio[place])
    words = f"the motion of the scene changes the overlap of contact {place + 1} by {largest:.3g} of the static overlap"
    if largest <= SMALL_RATIO:
        return f"linear: {words}; frequencies change by about {SOFTENING * largest**2:.1g}"
    return f"not linear: {words}, linear theory holds far below 1"


def _draw_dispersion(axis: Any, bands: list[pd.DataFrame]) -> None:
    letter_panel(axis, "a")
    for table, dashes in zip(bands, ("-", "--"), strict=False):
        for _, band in table.groupby("band"):
            axis.plot(band["phase_rad"] / pi, band["frequency_Hz"] / 1e3, dashes, color=BLUE)
        gaps = table.loc[table["band"].isna(), ["decay_per_cell", "frequency_Hz"]].to_numpy()
        decay, frequency = gaps.reshape(-1, GAP_POINTS, 2).T
        axis.plot(-decay / pi, frequency / 1e3, dashes, color=RED)
        axis.plot([], [], dashes, color=GREY, label=f"{table['static_force_N'][0]:.3g} N")
    if bands:
        axis.axvline(0, color=GREY, lw=0.6)
        axis.legend(title="static force")
        axis.set_ylim(0, SHOWN * edges_Hz(bands[-1]).max() / 1e3)
    axis.set(xlabel="−decay | phase, per cell / π", ylabel="frequency (kHz)")


def _draw_frequencies(axis: Any, modes: Modes, bands: list[pd.DataFrame], localised: NDArray[np.bool_]) -> None:
    letter_panel(axis, "b")
    shade_bands(axis.axhspan, bands)
    number, frequency = np.arange(1, len(localised) + 1), modes.frequency_Hz / 1e3
    axis.plot(number[~localised], frequency[~localised], ".", color=BLUE, ms=4)
    axis.plot(number[localised], frequency[localised], "x", color=RED, ms=5, label="localised")
    axis.set(xlabel="mode", ylim=(0, None))
    if localised.any():
        axis.legend(frameon=False, loc="lower right")


def shade_bands(span: Any, bands: Sequence[pd.DataFrame]) -> None:
    """Shades the bands at the largest static force by ``axhspan`` or ``axvspan``, in kHz."""
    for low, high in edges_Hz(bands[-1]) / 1e3 if bands else ():
        span(low, high, color=BAND, lw=0)


def _draw_shapes(axis: Any, modes: Modes) -> None:
    letter_panel(axis, "c")
    beads, count = modes.shape.shape
    for row, place in enumerate(sorted({*range(min(SHAPES, count)), count - 1})):
        level = 2.5 * row
        axis.axhline(level, color=GREY, lw=0.4)
        axis.plot(np.arange(1, beads + 1), level + modes.shape[:, place], ".-", color=BLUE, ms=3, lw=0.8)
        axis.text(1.02, level, f"{place + 1}", va="center", color=GREY, transform=axis.get_yaxis_transform())
    axis.set(xlabel="bead, from the wall", ylabel="displacement of modes", yticks=[])
