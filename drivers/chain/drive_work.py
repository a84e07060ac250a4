"""Force, work and impulse of a drive, from the samples of a run.

The drive is known at all times and only the motion of its body is interpolated between samples, so that the integrals
cross kinks and periods of the drive exactly. With the net force N of contacts and constant loads on the body:

* a force f has the work ``integral of f v``. The velocity without the drive, ``v - I / m`` with the impulse I of f,
  has the slope ``N / m``, which makes it a cubic between samples; the rest of the integral is ``I^2 / (2 m)``.
* a displacement u has the actuator force ``m u'' - N``, the work ``m (u'^2 - u'(0)^2) / 2 - integral of N u'`` and the
  impulse ``m (u' - u'(0)) - integral of N``.
"""

import numpy as np

from drivers.chain.chain import Chain
from validation.reference.hertz_chain import SAME_TIME, Array, Drive

GAUSS = np.polynomial.legendre.leggauss(6)


def drive_columns(chain: Chain, time_s: Array, force_N: Array, velocity_m_s: Array) -> dict[str, Array]:
    """Force of the drive on its body, its work and its impulse since time 0, each of shape (samples,).

    Args:
        chain: chain with a drive.
        time_s: sample times, shape (samples,).
        force_N: contact forces, shape (samples, bodies).
        velocity_m_s: velocities, shape (samples, bodies).

    Returns:
        Fields of ``drivers.chain.trace.Trace`` by name; empty without a drive.
    """
    drive = chain.drive
    if drive is None:
        return {}
    body, mass = drive.body, float(chain.mass_kg[drive.body])
    above = force_N[:, body + 1] if body + 1 < chain.bodies else 0.0
    net = force_N[:, body] - above + chain.load_N[body]
    value, rate, bend = drive.at(time_s)
    if drive.prescribed:
        slope = _slopes(drive, time_s, net)
        work = -_running(drive, 1, time_s, net, slope) + 0.5 * mass * (rate**2 - rate[0] ** 2)
        impulse = mass * (rate - rate[0]) - _running(drive, None, time_s, net, slope)
        return {"drive_N": mass * bend - net, "drive_work_J": work, "drive_impulse_N_s": impulse}
    impulse = _running(drive, 0, time_s, np.ones_like(net), np.zeros((2, len(net))))
    without, slope = velocity_m_s[:, body] - impulse / mass, np.tile(net / mass, (2, 1))
    work = _running(drive, 0, time_s, without, slope) + impulse**2 / (2 * mass)
    return {"drive_N": value, "drive_work_J": work, "drive_impulse_N_s": impulse}


def work_error_J(chain: Chain, time_s: Array, force_N: Array, velocity_m_s: Array) -> float:
    """Error of the work by the distance of samples: the largest difference if every other sample is left out."""
    fine, coarse = (drive_columns(chain, time_s[::every], force_N[::every], velocity_m_s[::every]) for every in (1, 2))
    return float(np.abs(fine["drive_work_J"][::2] - coarse["drive_work_J"]).max()) if fine else 0.0


def _slopes(drive: Drive, time_s: Array, values: Array) -> Array:
    """Slopes before and after each sample, from the samples between the same two kinks. Shape (2, samples)."""
    slopes = np.zeros((2, len(values)))
    begins = np.searchsorted(time_s * SAME_TIME, drive.segments[:, 0], side="left")
    ends = np.searchsorted(time_s, drive.segments[1:, 0] * SAME_TIME, side="right")
    for begin, end in zip(begins, [*ends, len(values)], strict=True):
        if end - begin > 1:
            part = np.gradient(values[begin:end], time_s[begin:end], edge_order=min(end - begin - 1, 2))
            slopes[0, begin + 1 : end], slopes[1, begin : end - 1] = part[1:], part[:-1]
    return slopes


def _running(drive: Drive, derivative: int | None, time_s: Array, values: Array, slopes: Array) -> Array:
    """Running integral of a derivative of the drive (None: of 1) times the cubic through values.

    ``slopes`` before and after each sample have the shape (2, samples).
    """
    kinks = drive.segments[(drive.segments[:, 0] > time_s[0]) & (drive.segments[:, 0] < time_s[-1]), 0]
    ends = np.union1d(time_s, kinks)
    half = np.diff(ends)[:, np.newaxis] / 2
    times = ends[:-1, np.newaxis] + half * (1 + GAUSS[0])
    place = np.searchsorted(time_s, ends[:-1], side="right") - 1
    interval = np.diff(time_s)[place, np.newaxis]
    x = (times - time_s[place, np.newaxis]) / interval
    first, second = values[place, np.newaxis], values[place + 1, np.newaxis]
    rise, fall = slopes[1, place, np.newaxis] * interval, slopes[0, place + 1, np.newaxis] * interval
    cubic = first + x * (rise + x * (3 * (second - first) - 2 * rise - fall + x * (2 * (first - second) + rise + fall)))
    factor = 1.0 if derivative is None else drive.at(times)[derivative]
    parts = (half * GAUSS[1] * factor * cubic).sum(axis=1)
    return np.asarray(np.append(0.0, np.cumsum(parts))[np.searchsorted(ends, time_s)])
