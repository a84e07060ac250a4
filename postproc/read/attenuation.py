"""Attenuation of the leading wave: what each contact passes on of its force's peak."""

import numpy as np

from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.read.signals import peaks


def incident_peaks(trace: Trace) -> Array:
    """Peak of the first wave above the force at time 0, by contact from the wall up; NaN where none came. (contacts,).

    The top contacts feel the striker, contact 1 what the wall throws back.
    """
    found = np.full(trace.force_N.shape[1], np.nan)
    least = 1e-9 * float(np.abs(trace.force_N).max())
    for contact, force in enumerate((trace.force_N - trace.force_N[0]).T):
        crests = peaks(trace.time_s, force) if np.ptp(force) > least else []
        if crests:
            found[contact] = crests[0].value
    return found


def transmissions(trace: Trace) -> Array:
    """Ratio of successive peaks of the incident wave: that at contact j over that at contact j+1. Shape (contacts-1,).

    Its difference from 1 is the attenuation a bead. That law has no force of its own, so
    ratios do not depend on the striker's speed. Far from the ends they are one number as long as the wave keeps its
    shape, for restitutions from 0.9 on; with more damping it goes on spreading, and ratios go on rising.
    """
    crest = incident_peaks(trace)
    return np.asarray(crest[:-1] / crest[1:])
