"""Waves in chains of unequal beads: tapered, decorated with light beads, and with one impurity.

Tapered: successive binary collisions pass the velocity from bead to bead by ``v_(k+1)/v_k = 2/(1 + m_(k+1)/m_k)``
(binary collision approximation: Harbola, Rosas, Esposito and Lindenberg, Phys. Rev. E 80, 031303, 2009). The logarithm
is accurate to a share of the order of the taper.

Decorated: light beads m between heavy beads M follow without inertia, so a wave is that of a chain of heavy beads with
a renormalised mass and interaction (Harbola, Rosas, Romero and Lindenberg, arXiv:0909.2627): M + m, and two Hertz
contacts in series, ``k / 2^(3/2)``. The error is of the order of m/M.

Impurity: a bead of mass ``(1 + e) m`` in a precompressed chain transmits ``1/(1 + e^2 tan^2(q/2))`` of the energy of
small waves with the wavenumber q per bead (closed forms: Martinez, Yasuda, Kim, Kevrekidis, Porter and Yang,
arXiv:1602.08651). A struck bead puts equal energy into all q, so its mean over q from 0 to pi, ``1/(1 + |e|)``, is the
share that passes of what goes towards the impurity.
"""

from math import log

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from validation.claims.measures.first_waves import first_wave, sensor_places, velocity_down
from validation.claims.measures.weak import loaded_springs_N_m, motion_by_modes
from validation.reference.travelling_wave import solve_travelling_wave


def taper(case: Case, trace: Trace) -> dict[str, float]:
    """Change of the peak velocity between the two sensors, as a logarithm, divided by that by binary collisions."""
    lower, upper = sensor_places(case)
    velocity, mass = velocity_down(trace), case.chain.mass_kg
    near, far = (first_wave(trace.time_s, velocity[:, place - 1]).value for place in (upper, lower))
    collisions = np.log(2 / (1 + mass[lower - 1 : upper - 1] / mass[lower:upper])).sum()
    return {"change_over_collisions": log(far / near) / float(collisions)}


def taper_theory(case: Case) -> dict[str, float]:
    """Unity; ValueError for equal beads."""
    lower, upper = sensor_places(case)
    if np.ptp(case.chain.mass_kg[lower - 1 : upper]) == 0:
        raise ValueError("equal beads between the sensors: nothing decays")
    return {"change_over_collisions": 1.0}


def decorated(case: Case, trace: Trace) -> dict[str, float]:
    """Speed between two heavy beads with sensors, divided by that of the effective chain at the same peak velocity."""
    lower, upper = sensor_places(case)
    chain, velocity = case.chain, velocity_down(trace)
    near, far = (first_wave(trace.time_s, velocity[:, place - 1]) for place in (upper, lower))
    stiffness = float(chain.stiffness[lower]) / 2**1.5
    mass = float(chain.mass_kg[lower - 1] + chain.mass_kg[lower])
    effective = solve_travelling_wave().speed_by_velocity * (stiffness / mass) ** 0.4 * far.value**0.2
    return {"speed_over_effective": (upper - lower) / 2 / (far.time_s - near.time_s) / effective}


def decorated_theory(case: Case) -> dict[str, float]:
    """Unity; ValueError if the sensors are not on the heavy beads of a dimer."""
    lower, upper = sensor_places(case)
    mass = case.chain.mass_kg[lower - 1 : upper]
    if (upper - lower) % 2 or np.ptp(mass[::2]) or np.ptp(mass[1::2]) or mass[0] <= mass[1]:
        raise ValueError("sensors that are not on two heavy beads of a chain of alternating beads")
    return {"speed_over_effective": 1.0}


def impurity(case: Case, trace: Trace) -> dict[str, float]:
    """Energy below the impurity at the end, divided by half the energy of the strike."""
    return _transmitted(case, velocity_down(trace)[-1], trace.force_N[-1] - trace.force_N[0])


def impurity_theory(case: Case) -> dict[str, float]:
    """The same by the modes of the finite chain."""
    velocity, force = motion_by_modes(case.chain, case.sample_times_s[-1:], np.arange(case.chain.beads))
    return _transmitted(case, -velocity[0], force[0])


def _transmitted(case: Case, velocity_m_s: Array, dynamic_N: Array) -> dict[str, float]:
    """Kinetic energy and that of the springs at one time; ValueError without a single impurity."""
    chain = case.chain
    odd = np.flatnonzero(chain.mass_kg != np.median(chain.mass_kg))
    if len(odd) != 1 or np.count_nonzero(chain.velocity_m_s) != 1:
        raise ValueError("not one bead of another mass, and one struck bead")
    below = slice(0, int(odd[0]))
    energy = chain.mass_kg[below] * velocity_m_s[below] ** 2 + dynamic_N[below] ** 2 / loaded_springs_N_m(chain)[below]
    return {"transmitted_share": float(energy.sum() / (chain.mass_kg @ chain.velocity_m_s**2 / 2))}


TAPER = {"change_over_collisions": "change of the logarithm of the peak velocity divided by that by binary collisions"}
DECORATED = {"speed_over_effective": "speed divided by that of the effective chain at the same peak velocity"}
IMPURITY = {"transmitted_share": "energy past the impurity divided by that sent towards it"}
