"""Drive of a chain: a force of time on one body, or the displacement of one body.

All wave forms are tables of segments. With ``tau = t - t_i`` after the beginning t_i of segment i, the value is
``w = c0 + c1 tau + sum of A_m sin(phi_m + omega_m tau + beta_m tau^2 / 2)`` with three sines, until the next segment
begins; the last one has no end. A sine under a Hann window is three sines, a chirp has beta, a polygon has c0 and c1.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SINES = (3, 7, 11)  # columns of A in a segment; phi, omega and beta follow each
COLUMNS = 15  # of a segment: t_i, c0, c1, three sines
SAME_TIME = 1 + 1e-12  # a time that equals the beginning of a segment up to rounding belongs to this segment


@dataclass(frozen=True, eq=False)
class Drive:
    """Drive of one body.

    Attributes:
        body: index of the body, from 0 for the lowest.
        prescribed: True if the value is the displacement of the body since time 0, in m, whatever forces act on it;
            False if it is a force on the body, in N. Both are upwards positive.
        segments: table of segments, the first of which begins at time 0. Shape (segments, ``COLUMNS``).

    Raises:
        ValueError: the table has another shape, values that are not finite, or beginnings that do not increase from 0.
    """

    body: int
    prescribed: bool
    segments: Array

    def __post_init__(self) -> None:
        table = np.array(self.segments, dtype=float)
        if table.ndim != 2 or table.shape[1] != COLUMNS or not len(table) or not np.isfinite(table).all():
            raise ValueError(f"segments: shape {table.shape}, expected finite values of shape (segments, {COLUMNS})")
        if table[0, 0] != 0 or not (np.diff(table[:, 0]) > 0).all():
            raise ValueError("segments: expected beginnings that increase from 0")
        object.__setattr__(self, "segments", table)

    def at(self, time_s: Array) -> tuple[Array, Array, Array]:
        """Values, their rates and second derivatives at some times, of any shape; at a kink those after it."""
        place = np.searchsorted(self.segments[:, 0], np.asarray(time_s) * SAME_TIME, side="right") - 1
        rows = np.moveaxis(self.segments[place], -1, 0)
        value, rate, bend = wave(rows, time_s - rows[0])
        return value, rate, bend


def wave(segment: Any, tau: Any) -> tuple[Any, Any, Any]:
    """Value, rate and second derivative of a segment; the kernels compile this function for single numbers."""
    value, rate, bend = segment[1] + segment[2] * tau, segment[2] + 0.0 * tau, 0.0 * tau
    for k in SINES:
        amplitude, sweep = segment[k], segment[k + 3]
        turning = segment[k + 2] + sweep * tau
        angle = segment[k + 1] + tau * (segment[k + 2] + 0.5 * sweep * tau)
        sine, cosine = np.sin(angle), np.cos(angle)
        value = value + amplitude * sine
        rate = rate + amplitude * turning * cosine
        bend = bend + amplitude * (sweep * cosine - turning * turning * sine)
    return value, rate, bend


def loads_N(constant_N: Array, drive: Drive | None, time_s: Array) -> Array:
    """Loads on all bodies with the force of a drive. Shape (times, bodies), or (bodies,) without such a force."""
    if drive is None or drive.prescribed:
        return constant_N
    loads = np.tile(constant_N, (len(time_s), 1))
    loads[:, drive.body] += drive.at(time_s)[0]
    return loads
