"""The linear stability limit of velocity Verlet on a chain: 2 over its highest frequency."""

import numpy as np
from scipy.linalg import eigvalsh_tridiagonal

from drivers.chain import Array, Chain


def stable_step(chain: Chain, largest_force_N: Array) -> float:
    """``2 / omega_max`` in s, with each contact's tangent stiffness at the largest force it carries; inf without any.

    ``dF/d overlap = (3/2) k^(2/3) F^(1/3)``; the chain of springs between the masses has the frequencies of a
    tridiagonal matrix.

    Args:
        chain: the chain.
        largest_force_N: of each contact, shape (bodies,).
    """
    spring = 1.5 * np.cbrt(chain.stiffness**2 * largest_force_N)
    above = np.append(spring[1:], 0.0)
    mass = chain.mass_kg
    diagonal = (spring + above) / mass
    beside = -spring[1:] / np.sqrt(mass[:-1] * mass[1:])
    last = len(mass) - 1
    highest = eigvalsh_tridiagonal(diagonal, beside, select="i", select_range=(last, last))[0] if last else diagonal[0]
    return float(2 / np.sqrt(highest)) if highest > 0 else float("inf")
