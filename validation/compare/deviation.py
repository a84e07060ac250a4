"""How far two traces are apart: in forces, and in energy and momentum, in which a fault of velocities alone shows."""

from dataclasses import dataclass

import numpy as np

from drivers.chain.chain import Array, Chain, energy_put_in, moving_at_start
from drivers.chain.trace import Trace


@dataclass(frozen=True)
class Deviation:
    """How far two traces are apart, and where.

    Attributes:
        share: of the forces, over the largest |F_ref|; of the kinetic energy over what is put in, or of the momentum
            over the largest there can be.
        quantity: such as ``contact 3`` or ``momentum``.
    """

    share: float
    time_s: float
    quantity: str

    @property
    def place(self) -> str:
        """Where that is, in words."""
        return f"{self.quantity} at {self.time_s * 1e6:g} µs"


def deviation(trace: Trace, reference: Trace, samples: int | None = None) -> Deviation:
    """The largest force difference from a reference, whose largest force is 1; all samples count by default.

    Raises:
        ValueError: the traces differ in contacts or sample times.
    """
    if trace.force_N.shape != reference.force_N.shape:
        raise ValueError(f"{trace.force_N.shape} samples and contacts against {reference.force_N.shape}")
    if not np.allclose(trace.time_s, reference.time_s, rtol=1e-12, atol=0):
        raise ValueError("the sample times differ")
    share = shares_apart(trace.force_N, reference.force_N)[:samples]
    sample, column = np.unravel_index(int(np.argmax(share)), share.shape)
    return _in_contact(trace, share, int(sample), int(column))


def first_deviation(trace: Trace, reference: Trace, level: float) -> Deviation | None:
    """The largest force difference at the first sample at which any is beyond a level; None where none is."""
    share = shares_apart(trace.force_N, reference.force_N)
    beyond = first_beyond(share, level)
    return _in_contact(trace, share, *beyond) if beyond else None


def _in_contact(trace: Trace, share: Array, sample: int, column: int) -> Deviation:
    return Deviation(float(share[sample, column]), float(trace.time_s[sample]), f"contact {column + 1}")


def shares_apart(force_N: Array, reference_N: Array, largest_N: float | None = None) -> Array:
    """|F - F_ref| over the largest |F_ref|; inf where there is no number. All of shape (samples, contacts).

    Args:
        force_N: the forces in question.
        reference_N: what they should be.
        largest_N: the largest force, where these are but the first samples.
    """
    largest_N = largest_N or float(np.abs(reference_N).max()) or 1.0
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(np.abs(force_N - reference_N) / largest_N, nan=np.inf)


def first_beyond(share: Array, level: float | Array) -> tuple[int, int] | None:
    """The first sample at which any contact is beyond a level, and the column furthest off then; None where none is.

    Args:
        share: differences of forces. Shape (samples, contacts).
        level: in the same terms, for all samples or for each. Shape (samples,).
    """
    beyond = share.max(axis=1) > level
    if not beyond.any():
        return None
    sample = int(np.argmax(beyond))
    return sample, int(np.argmax(share[sample]))


def motion_scales(chain: Chain, trace: Trace) -> Array:
    """What kinetic energies and momenta are counted by: the energy put in, the largest momentum there can be.

    The latter is at least that of the loads' impulse, and that of all bodies at time 0 without directions, so that a
    chain at rest has one, and what meets head on. In J and N s, shape (2,).
    """
    duration = float(trace.time_s[-1])
    energy = energy_put_in(chain, duration) or 1.0
    loads = abs(float(chain.load_N.sum())) * duration
    momentum = max(float(np.abs(trace.momentum_N_s).max()), moving_at_start(chain), loads) or 1.0
    return np.array([energy, momentum])


def motion_deviation(chain: Chain, trace: Trace, reference: Trace, samples: int | None = None) -> Deviation:
    """The largest difference of kinetic energy and momentum between traces of equal sample times."""
    found = np.array([trace.kinetic_energy_J, trace.momentum_N_s])[:, :samples]
    right = np.array([reference.kinetic_energy_J, reference.momentum_N_s])[:, :samples]
    shares = np.abs(found - right) / motion_scales(chain, reference)[:, None]
    which, sample = np.unravel_index(int(np.argmax(shares)), shares.shape)
    quantity = ("kinetic energy", "momentum")[int(which)]
    return Deviation(float(shares[which, sample]), float(trace.time_s[sample]), quantity)
