"""Two equal solitary waves that meet head on in the middle of a free chain.

They meet at a contact where the number of beads is even, at a bead where it is odd. Each half then moves as if its
wave ran into a wall: at a contact into one of stiffness ``2 sqrt(2) k``, since a wall sees half of the overlap; at a
bead, which stays where it is, into one of stiffness k. What leaves are the two waves and a weak secondary one behind
each, stronger from a contact than from a bead (Santibanez, Munoz, Caussarieu, Job and Melo, Phys. Rev. E 84, 026604,
2011). A share of 0.0299 and one of 0.0085 of the wave are all there is: read nearer than 30 contacts from the middle
they are still growing (0.0244 and 0.0064 after 5 contacts, 0.0267 and 0.0070 after 10, 0.0298 and 0.0084 after 20).
"""

from functools import cache
from math import sqrt

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.read.signals import first_peak, peaks
from validation.independent.scipy_chain import led_to_wall

DISTANCE = 40  # contacts above the middle: the secondary wave has settled to 1e-4 of itself from 30 on
PROMINENCE = 1e-3  # of the wave: the weakest secondary wave is 8.5e-3 of it
HALF_BEADS = 120
START = DISTANCE + 20.5  # bead of the half chain at which the exact wave starts
LAST = 165.0  # beads that the wave travels until the secondary one has come by


def measure(case: Case, trace: Trace) -> dict[str, float]:
    """Peaks in the middle and ``DISTANCE`` contacts above it, over the incoming wave's there.

    Raises:
        ValueError: the waves do not meet and pass, or the chain is too short.
    """
    chain = case.chain
    middle = middle_column(chain.beads)
    if middle + DISTANCE >= chain.beads:
        raise ValueError(f"{chain.beads} beads: none {DISTANCE} contacts above the middle")
    force = trace.force_N
    values = shares(trace.time_s, force[:, middle], force[:, middle + DISTANCE])
    incoming = force[:, middle + DISTANCE].max()
    inner = force[:, 1:]  # contact 1 of a free chain is none
    put_in = float(chain.mass_kg @ np.abs(chain.velocity_m_s)) / 2
    return values | {
        "asymmetry": float(np.abs(inner - inner[:, ::-1]).max() / incoming),
        "momentum_share": float(np.abs(trace.momentum_N_s).max() / put_in),
    }


def middle_column(beads: int) -> int:
    """Column of the contact in the middle, or just above the bead there."""
    return (beads + 1) // 2


def shares(time_s: Array, middle_N: Array, beyond_N: Array) -> dict[str, float]:
    """The middle's peak, and what leaves, over the wave that came by.

    Args:
        time_s: shape (samples,).
        middle_N: force where the waves meet. Shape (samples,).
        beyond_N: force of a contact that they pass before and after. Shape (samples,).

    Raises:
        ValueError: fewer than three waves pass it.
    """
    passing, together = peaks(time_s, beyond_N, prominence=PROMINENCE), first_peak(time_s, middle_N)
    if len(passing) < 3 or together is None:
        raise ValueError(f"{len(passing)} waves within the run, three expected: incoming, outgoing, secondary")
    incoming, outgoing, secondary = passing[:3]
    return {
        "middle_share": together.value / incoming.value,
        "outgoing_share": outgoing.value / incoming.value,
        "secondary_share": secondary.value / incoming.value,
    }


def theory(case: Case) -> dict[str, float]:
    """Half of the chain with the exact solitary wave in it, before the wall that stands for the other half."""
    return dict(_half(at_contact=case.chain.beads % 2 == 0)) | {"asymmetry": 0.0, "momentum_share": 0.0}


@cache
def _half(*, at_contact: bool) -> dict[str, float]:
    time, found = led_to_wall(HALF_BEADS, START, 2 * sqrt(2) if at_contact else 1.0, LAST)
    return shares(time, found[:, 0], found[:, DISTANCE])


QUANTITIES = {
    "middle_share": "largest force where the waves meet, over that of one wave",
    "outgoing_share": "peak of the wave that leaves, over that of the one that came",
    "secondary_share": "peak of the secondary wave, over that of the wave that came",
    "asymmetry": "largest difference of mirrored contacts' forces, over the wave's",
    "momentum_share": "largest momentum of the chain, over that of either half at first",
}
SOURCE = "the exact solitary wave, integrated by scipy's DOP853 up to the wall that stands for the other half"
