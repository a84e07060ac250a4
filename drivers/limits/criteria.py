"""Common time-step criteria that do not integrate the motion: Rayleigh, Hertz and P-wave time."""

from collections.abc import Iterator
from math import inf, pi, sqrt

import numpy as np

from drivers.chain.case import Case


def rayleigh_time(case: Case) -> float:
    """Smallest Rayleigh time of any bead, ``pi R sqrt(rho / G) / (0.1631 nu + 0.8766)``, in s."""
    return min(
        pi * radius * sqrt(density / (modulus / (2 * (1 + ratio)))) / (0.1631 * ratio + 0.8766)
        for radius, density, modulus, ratio in _balls(case)
    )


def p_wave_time(case: Case) -> float:
    """Smallest ``R sqrt(rho / E)`` of any bead, in s, as in YADE's ``PWaveTimeStep``."""
    return min(radius * sqrt(density / modulus) for radius, density, modulus, _ in _balls(case))


def hertz_time(case: Case) -> float:
    """Smallest duration of an isolated collision of two neighbours, ``2.87 (m*^2 / (R* E*^2 v))^(1/5)``, in s.

    The speed v is the largest at time 0, as in LIGGGHTS' ``check/timestep/gran``. inf if nothing moves.
    """
    chain = case.chain
    speed = float(np.abs(chain.velocity_m_s).max())
    inverse = 1 / chain.mass_kg + np.append(0.0, 1 / chain.mass_kg[:-1])
    stiffest = chain.stiffness * inverse  # k = (4/3) E* sqrt(R*), so R* E*^2 = (3 k / 4)^2
    if not speed or not stiffest.any():
        return inf
    worst = int(np.argmax(stiffest))
    return float(2.87 * (1 / inverse[worst] ** 2 / ((0.75 * chain.stiffness[worst]) ** 2 * speed)) ** 0.2)


# usual fraction of each time, and its function
CRITERIA = {"0.2 Rayleigh": (0.2, rayleigh_time), "0.1 Hertz": (0.1, hertz_time), "P-wave": (1.0, p_wave_time)}


def _balls(case: Case) -> Iterator[tuple[float, float, float, float]]:
    """Radius, density, Young's modulus and Poisson's ratio of each distinct sphere."""
    chain = case.chain
    for name, radius, mass in sorted(set(zip(chain.materials, chain.radius_m, chain.mass_kg, strict=True))):
        if np.isfinite(radius):
            yield float(radius), float(mass / (4 / 3 * pi * radius**3)), *case.scene.elastic_constants(name)
