"""What all bodies together do: their kinetic energy and momentum, in which a fault of velocities alone shows."""

from dataclasses import dataclass

import numpy as np

from drivers.chain import Array, Chain, energy_put_in, moving_at_start
from drivers.trace import Trace


@dataclass(frozen=True)
class MotionDeviation:
    """How far two motions are apart.

    Attributes:
        share: the larger difference, of the kinetic energy over what is put in, of the momentum over the largest.
        quantity, time_s: which, and where that is.
    """

    share: float
    quantity: str
    time_s: float


def motion_scales(chain: Chain, trace: Trace) -> Array:
    """What kinetic energies and momenta are counted by: the energy put in, the largest momentum there can be.

    The latter is at least that of the loads' impulse, and that of all bodies at time 0 without directions, so that a
    chain at rest has one, and what meets head on. Shape (2,).
    """
    duration = float(trace.time_s[-1])
    energy = energy_put_in(chain, duration) or 1.0
    loads = abs(float(chain.load_N.sum())) * duration
    momentum = max(float(np.abs(trace.momentum_N_s).max()), moving_at_start(chain), loads) or 1.0
    return np.array([energy, momentum])


def motion_deviation(chain: Chain, trace: Trace, reference: Trace, samples: int | None = None) -> MotionDeviation:
    """The largest difference of kinetic energy and momentum between traces of equal sample times."""
    found = np.array([trace.kinetic_energy_J, trace.momentum_N_s])[:, :samples]
    right = np.array([reference.kinetic_energy_J, reference.momentum_N_s])[:, :samples]
    shares = np.abs(found - right) / motion_scales(chain, reference)[:, None]
    which, sample = np.unravel_index(int(np.argmax(shares)), shares.shape)
    quantity = ("kinetic energy", "momentum")[int(which)]
    return MotionDeviation(float(shares[which, sample]), quantity, float(trace.time_s[sample]))
