"""Transfer function of a weakly driven chain: contact forces of two places divided by a sine force on a body.

Under a weak force ``A e^(i Omega t)`` the displacements ``u e^(i Omega t)`` solve ``(K - Omega^2 M) u = A``,
with the masses M and the tridiagonal matrix K of the contact stiffnesses. A start from rest leaves free motions in an
elastic chain, at the frequencies of its modes: a Kaiser window over the whole record takes them out, the harmonics and
the shift of the mean as well. The finite amplitude A adds shares of the order of ``(A / F_0)^2``, and of ``A / F_0`` at
sums and differences of the modes' frequencies, of which some lie near the drive's.
"""

from math import pi

import numpy as np
from scipy.linalg import solve_banded
from scipy.signal.windows import kaiser

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.linear.modes import modes_of
from validation.claims.measures.first_waves import sensor_places
from validation.claims.measures.weak import loaded_springs_N_m

SHAPE = 20.0  # beta of the window
CYCLES = 6.5  # half width of its main lobe, in cycles of the record: sqrt(1 + (beta / pi)^2); sidelobes below 2e-8


def measure(case: Case, trace: Trace) -> dict[str, float]:
    """Gains and phases of the contact forces below the highest and the lowest sensor bead."""
    force_N, omega = _sine(case)
    window = kaiser(len(trace.time_s), SHAPE)
    turning = window * np.exp(-1j * omega * trace.time_s)
    return _transfer(case, 2j / window.sum() * (turning @ (trace.force_N - trace.force_N[0])) / force_N)


def theory(case: Case) -> dict[str, float]:
    """The same of the linear equations; ValueError if the record does not separate the drive from the nearest mode."""
    chain, (_, omega) = case.chain, _sine(case)
    spring = loaded_springs_N_m(chain)
    assert chain.drive is not None
    nearest_Hz = np.abs(modes_of(chain).frequency_Hz - omega / (2 * pi)).min()
    if nearest_Hz * case.scene.run.duration < CYCLES:
        raise ValueError("run.duration: too short to separate the drive's frequency from that of the nearest mode")
    beside = -spring[1:]
    diagonal = spring + np.append(spring[1:], 0.0) - omega**2 * chain.mass_kg
    rows = np.array([np.append(0.0, beside), diagonal, np.append(beside, 0.0)])
    unit = np.zeros(chain.bodies)
    unit[chain.drive.body] = 1.0
    moved = solve_banded((1, 1), rows, unit)
    return _transfer(case, -spring * np.diff(moved, prepend=0.0))


def _sine(case: Case) -> tuple[float, float]:
    """Amplitude in N, upwards positive, and angular frequency of the drive; ValueError for another drive."""
    drive = case.scene.drive
    if drive is None or drive.form != "sine" or not drive.force or not drive.frequency or drive.cycles or drive.start:
        raise ValueError("no sine force that lasts from time 0")
    return drive.force, 2 * pi * drive.frequency


def _transfer(case: Case, part: Array) -> dict[str, float]:
    """Quantities of the complex amplitudes of contact forces divided by that of the drive, shape (contacts,)."""
    far, near = sensor_places(case)
    chosen = part[[near - 1, far - 1]]
    return dict(zip(QUANTITIES, map(float, [*np.abs(chosen), *np.angle(chosen)]), strict=True))


QUANTITIES = {
    "near_gain": "amplitude of the contact force below the upper sensor bead divided by that of the drive",
    "far_gain": "amplitude of the contact force below the lower sensor bead divided by that of the drive",
    "near_phase_rad": "phase of the contact force below the upper sensor bead against the drive",
    "far_phase_rad": "phase of the contact force below the lower sensor bead against the drive",
}
SOURCE = "(K - Omega^2 M) u = A of the linearised chain, K = (3/2) k^(2/3) F^(1/3)"
