"""What bounds the time step: the frequencies that contacts can reach, from energy alone.

A contact's overlap cannot exceed what all the energy that turns into motion could press into it, so its stiffness and
the chain's highest frequency are bounded without following the motion. The bound is within a tenth of the limit for
most scenes; ``validation.stable_step`` follows the motion where that is not enough.
"""

from dataclasses import dataclass

import numpy as np

from drivers.chain import Array, Chain, contact_stiffness, energy_put_in

SAFETY = 0.968  # of 2 / omega_max: 1000 random scenes blow up at 0.969 to 1.198 of it, the overshoot included
# overlaps of a first step count so many times: a light body that touches a heavy one gains its own kinetic energy where
# y = (v dt / overlap)^(5/2) has (5/8 y)^2 = 1 + y / 4, which is 2 / omega at 1.195 times the overlap v dt
OVERSHOOT = 1.195


@dataclass(frozen=True)
class Reached:
    """What each contact reaches in a motion; arrays of shape (bodies,).

    Attributes:
        overlap_m: the largest overlap.
        closing_m_s: the largest speed at which it closes: one step of it is an overlap, however small the exact one.
    """

    overlap_m: Array
    closing_m_s: Array

    def spring(self, chain: Chain, time_step_s: float) -> Array:
        """The stiffest each contact gets with steps of that size, in N/m. Shape (bodies,)."""
        return contact_stiffness(
            chain.stiffness, np.maximum(self.overlap_m, OVERSHOOT * self.closing_m_s * time_step_s)
        )


def at_most(chain: Chain, duration_s: float) -> Reached:
    """Bounds of what contacts reach, by energy.

    About equilibrium, a contact that takes up the energy E by a further overlap x has ``E >= (2/5) k x^(5/2)`` and
    ``E >= K x^2 / 2`` with its stiffness K at rest, since Hertz's force curves upwards.
    """
    energy = energy_put_in(chain, duration_s)
    resting = np.maximum(chain.overlap_m, 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        by_hertz = (2.5 * energy / chain.stiffness) ** 0.4
        by_spring = np.sqrt(2 * energy / contact_stiffness(chain.stiffness, resting))
    further = np.where(chain.stiffness > 0, np.fmin(by_hertz, by_spring), 0.0)
    inverse = 1 / chain.mass_kg
    closing = np.sqrt(2 * energy * (inverse + np.append(0.0, inverse[:-1])))
    return Reached(resting + further, np.where(chain.stiffness > 0, closing, 0.0))


def share_at_most(chain: Chain, duration_s: float, time_step_s: float) -> float:
    """A bound of the step's share of the stability limit: at 1 and below it is stable.

    The highest frequency is bounded by rows of the matrix of springs and masses (Gershgorin).
    """
    spring = at_most(chain, duration_s).spring(chain, time_step_s)
    root = np.sqrt(chain.mass_kg)
    beside = spring / (root * np.append(np.inf, root[:-1]))
    rows = (spring + np.append(spring[1:], 0.0)) / chain.mass_kg + beside + np.append(beside[1:], 0.0)
    return float(time_step_s * np.sqrt(rows.max()) / 2 / SAFETY)
