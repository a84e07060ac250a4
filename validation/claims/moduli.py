"""Claims on which Young's modulus the measured speeds speak for."""

import numpy as np

from postproc.paper.modulus_scores import deviations
from postproc.paper.quoted import quoted
from postproc.paper.strikes import Amplitude, contact_peak, sensor_amplitude

STRONG_ROWS, WEAK_ROWS = slice(0, 2), slice(2, None)  # rows of Table 1


def _rms(modulus_MPa: float, forces: slice, reading: Amplitude = contact_peak) -> float:
    """Measured speed off the simulated, root mean square over some forces, per cent."""
    return float(100 * np.sqrt((deviations(modulus_MPa, reading)[forces] ** 2).mean()))


def _nearest(forces: slice, reading: Amplitude) -> float:
    """The modulus whose simulated speeds are nearest to the measured ones, MPa."""
    return min(quoted().ptfe.moduli_MPa, key=lambda modulus: _rms(modulus, forces, reading))


def nearest_large() -> float:
    """Nearest of the paper's three moduli for 5 and 2 N, the measured force read as the contact's."""
    return _nearest(STRONG_ROWS, contact_peak)


def nearest_small() -> float:
    """Nearest of the paper's three moduli for 0.6, 0.1 and 0.06 N, the measured force read as the contact's."""
    return _nearest(WEAK_ROWS, contact_peak)


def nearest_large_average() -> float:
    """Nearest of the paper's three moduli for 5 and 2 N, the measured force read as the sensors' average."""
    return _nearest(STRONG_ROWS, sensor_amplitude)


def nearest_small_average() -> float:
    """Nearest of the three moduli for 0.6, 0.1 and 0.06 N, the measured force read as the sensors' average."""
    return _nearest(WEAK_ROWS, sensor_amplitude)


def middle_at_low() -> float:
    """Measured speed off the simulated for 1000 MPa, root mean square over 0.6, 0.1 and 0.06 N, per cent."""
    return _rms(1000, WEAK_ROWS)


def hard_at_low() -> float:
    """Measured speed off the simulated for 1460 MPa, root mean square over 0.6, 0.1 and 0.06 N, per cent."""
    return _rms(1460, WEAK_ROWS)


def soft_at_high() -> float:
    """Measured speed off the simulated for 600 MPa, root mean square over 5 and 2 N, per cent."""
    return _rms(600, STRONG_ROWS)


def softer_is_worse() -> float:
    """Measured speed off the simulated at 5 N for 400 MPa over the same for 600 MPa."""
    return float(deviations(400, contact_peak)[0] / deviations(600, contact_peak)[0])
