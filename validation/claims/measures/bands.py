"""Band edges: the edge lines in the spectrum of a finite chain that a weak strike rings.

In an infinite chain of contacts with the stiffness K waves propagate up to ``omega = 2 sqrt(K/m)``. If heavy and light
beads alternate, with masses M and m, up to ``sqrt(2 K/M)`` (acoustic band), and from ``sqrt(2 K/m)`` to
``sqrt(2 K (1/m + 1/M))`` (optical band; Brillouin, Wave Propagation in Periodic Structures, 1953). The modes
of a finite chain without states in the gap lie inside the bands, the outermost next to the edges: their distance is
proportional to ``1/count^2``. The gap is the widest interval between neighbouring modes.
"""

import numpy as np
from scipy.signal import find_peaks
from scipy.signal.windows import blackmanharris

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.linear.modes import modes_of
from validation.claims.measures.weak import loaded_springs_N_m

PADDING = 4  # length of the transformed record divided by that of the samples
FLOOR = 1e-6  # share of the largest power: above rounding and sums of frequencies, below every rung mode


def lines_Hz(time_s: Array, force_N: Array) -> Array:
    """Frequencies of the maxima in the summed power of dynamic forces, by parabolas through logarithms.

    Sidelobes of the window, Blackman and Harris' of four terms, lie 92 dB below its main lobe, 8 samples of an unpadded
    spectrum wide: lines closer than that merge.

    Args:
        time_s: equally spaced, shape (samples,).
        force_N: shape (samples, contacts).
    """
    samples = len(time_s)
    dynamic = (force_N - force_N[0]) * blackmanharris(samples, sym=False)[:, np.newaxis]
    power = (np.abs(np.fft.rfft(dynamic, PADDING * samples, axis=0)) ** 2).sum(axis=1)
    places, _ = find_peaks(power, height=FLOOR * power.max())
    left, top, right = (np.log(power[places + step]) for step in (-1, 0, 1))
    shift = (left - right) / (left - 2 * top + right) / 2
    spacing_s = float(time_s[-1] - time_s[0]) / (samples - 1)
    return np.asarray((places + shift) / (PADDING * samples * spacing_s))


def measure(_: Case, trace: Trace) -> dict[str, float]:
    """Lines at the band edges and number of lines."""
    return _edges(lines_Hz(trace.time_s, trace.force_N))


def theory(case: Case) -> dict[str, float]:
    """The same of the modes of the chain's springs and masses; ValueError for a chain without such modes."""
    loaded_springs_N_m(case.chain)
    return _edges(modes_of(case.chain).frequency_Hz)


def _edges(frequency_Hz: Array) -> dict[str, float]:
    """Quantities of ascending frequencies; ValueError for fewer than two."""
    if len(frequency_Hz) < 2:
        raise ValueError("fewer than two lines in the spectrum")
    below = int(np.argmax(np.diff(frequency_Hz)))
    edges = (frequency_Hz[below], frequency_Hz[below + 1], frequency_Hz[-1], len(frequency_Hz))
    return dict(zip(QUANTITIES, map(float, edges), strict=True))


QUANTITIES = {
    "below_gap_Hz": "highest line below the gap: top of the acoustic band",
    "above_gap_Hz": "lowest line above the gap: bottom of the optical band",
    "highest_Hz": "highest line: top of the highest band, the cutoff of a chain of equal beads",
    "lines": "number of lines, one a bead",
}
SOURCE = "modes of the linearised chain, K = (3/2) k^(2/3) F^(1/3)"
