"""Small motions of a chain about its static equilibrium: modes, and bands of its pattern.

Each loaded contact is a spring ``K = (3/2) k d^(1/2) = (3/2) k^(2/3) F^(1/3)`` (Nesterenko, Dynamics of Heterogeneous
Materials, chapter 1), each open contact none. The striker and a body that moves as prescribed are not part of it.

A pattern of p members, repeated without end at one static force, has p bands: the frequencies of Bloch waves, whose
displacements ``u_{j+p} = u_j exp(i q)`` have a phase q per cell from 0 to pi. Long waves travel at the static sound
speed ``c = a / sqrt(M C)``, with the length a and the mass M of a cell and the sum C of its compliances 1/K.
"""

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, contact_stiffness, contact_stiffness_at

MAX_BEADS = 5_000  # with modes; all shapes of 5,000 beads take 200 MB
PHASES = 101  # of the dispersion curve
# A contact that oscillates by r d about its overlap d is slower by r^2 / 24, by the Lindstedt method.
SOFTENING = 1 / 24


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


@dataclass(frozen=True)
class Bands:
    """Bloch waves of a pattern at one static force.

    Attributes:
        force_N: static force.
        phase: phase q per cell, from 0 to pi. Shape (phases,).
        frequency_Hz: frequencies, the lowest band first. Shape (phases, members).
        group_velocity_m_s: group velocity ``d omega / d q`` times the length of a cell. Shape (phases, members).
        sound_speed_m_s: speed of long waves.
    """

    force_N: float
    phase: Array
    frequency_Hz: Array
    group_velocity_m_s: Array
    sound_speed_m_s: float

    @property
    def edges_Hz(self) -> Array:
        """Lowest and highest frequency of each band. Shape (members, 2)."""
        return np.column_stack([self.frequency_Hz.min(axis=0), self.frequency_Hz.max(axis=0)])


def springs_N_m(chain: Chain) -> Array:
    """Contact stiffness K of each contact between beads, or with the wall, at time 0. Shape (beads,)."""
    return contact_stiffness(chain.stiffness, np.maximum(chain.overlap_m, 0.0))[: chain.beads]


def static_forces_N(chain: Chain) -> Array:
    """Elastic forces of these contacts at time 0. Shape (beads,)."""
    return np.asarray(chain.elastic_N[: chain.beads])


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


def bands_of(case: Case, force_N: float) -> Bands:
    """Bands of the pattern of a scene, which is one bead without ``[[chain.pattern]]``, at a static force.

    The cell is the lowest one above the first that has no single bead and no sensor mass.

    Raises:
        ValueError: the chain has no such cell, or a taper.
    """
    chain, members = case.chain, len(case.scene.chain.members)
    if case.scene.chain.taper_at(case.chain.beads) != 1:
        raise ValueError("a tapered chain has no bands")
    cell = _cell(case, members)
    mass, radius = chain.mass_kg[cell], chain.radius_m[cell]
    spring = np.array([contact_stiffness_at(k, force_N) for k in chain.stiffness[cell]])  # below each member
    phase = np.linspace(0.0, pi, PHASES)
    matrix = np.zeros((PHASES, members, members), complex)
    for j in range(members):
        below, turn = (j - 1) % members, np.exp(-1j * phase) if j == 0 else 1.0
        matrix[:, j, j] += (spring[j] + spring[(j + 1) % members]) / mass[j]
        matrix[:, j, below] -= spring[j] * turn / sqrt(mass[j] * mass[below])
        matrix[:, below, j] -= spring[j] * np.conj(turn) / sqrt(mass[j] * mass[below])
    squared, vectors = np.linalg.eigh(matrix)
    omega = np.sqrt(np.maximum(squared, 0.0))
    omega[0, 0] = 0.0  # a cell that moves as a whole, up to rounding
    # Hellmann and Feynman: d omega^2 / d q is the expectation value of dD/dq, which only the contact of cells has
    last, across = members - 1, spring[0] / sqrt(mass[0] * mass[-1])
    slope = 2 * (np.conj(vectors[:, 0]) * 1j * across * np.exp(-1j * phase)[:, None] * vectors[:, last]).real
    length = float(2 * radius.sum() - ((force_N / chain.stiffness[cell]) ** (2 / 3)).sum())
    sound = length / sqrt(float(mass.sum()) * float((1 / spring).sum()))
    with np.errstate(divide="ignore", invalid="ignore"):
        group = np.where(omega > 0, length * slope / (2 * omega), 0.0)
    group[0, 0] = sound
    return Bands(force_N, phase, omega / (2 * pi), group, sound)


def _cell(case: Case, members: int) -> slice:
    """Beads of a cell that has no bead of another kind, as low as possible; the contact below it is one of the pattern.

    Raises:
        ValueError: there is none.
    """
    table = case.scene.chain
    special = {*table.bead_at, *(place for place, sensor in table.sensor_at.items() if sensor.mass)}
    for start in range(members, case.chain.beads - members + 1, members):
        if not special & set(range(start, start + members + 1)):
            return slice(start, start + members)
    raise ValueError("the chain has no cell of its pattern, between its ends, without single beads and sensor masses")


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


def overlap_ratio(case: Case, force_N: Array) -> Array:
    """Largest change of the overlap of each contact divided by its static overlap, from forces of a run.

    Args:
        case: the case.
        force_N: contact forces. Shape (samples, bodies).

    Returns:
        Ratios of the contacts of beads; inf for a contact without load. Shape (beads,).
    """
    force = np.maximum(force_N[:, : case.chain.beads], 0.0)
    static = static_forces_N(case.chain)
    with np.errstate(divide="ignore", invalid="ignore"):
        changes = np.abs((force / static) ** (2 / 3) - 1).max(axis=0)
    return np.asarray(np.where(static > 0, changes, np.inf))
