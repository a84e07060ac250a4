"""Claims on Fig. 4: what its sensor beads read, on their faces and from one to the next; what is conserved."""

import numpy as np
from scipy.interpolate import CubicSpline

from drivers.chain.chain import Array
from postproc.paper import theory
from postproc.paper.quoted import quoted
from postproc.paper.simulate import UNTIL_REFLECTED, Simulation, case_of, exact
from postproc.paper.strikes import speed_between_sensors
from postproc.read.sensors import sensor_average
from postproc.read.signals import peaks
from validation.claims.simulated import BARE, Run, waves


def _fig4(run: Run) -> Simulation:
    return run(case_of("fig4", UNTIL_REFLECTED))


def force(run: Run) -> float:
    """Peak of the sensor average in bead 9 of Fig. 4, N."""
    return _fig4(run).values["bead_9_peak_N"]


def force_over_measured(run: Run) -> float:
    """Peak of the sensor average in bead 9 of Fig. 4 over the quoted 2 N."""
    return force(run) / quoted().fig4.leading_force_N


def speed(run: Run) -> float:
    """Speed from bead 9 to bead 5 of Fig. 4, m/s."""
    return speed_between_sensors(_fig4(run))


def width(run: Run) -> float:
    """Width at bead 5 of Fig. 4 at 0.2 % of the peak, in diameters."""
    return _fig4(run).values["bead_5_width_0.2pct_diameters"]


def duration(run: Run) -> float:
    """Duration at bead 5 of Fig. 4 at 0.2 % of the peak, microseconds."""
    return _fig4(run).values["bead_5_duration_0.2pct_s"] * 1e6


def reflected(run: Run) -> float:
    """Reflected over incident peak in bead 9 of Fig. 4."""
    values = _fig4(run).values
    return values["bead_9_reflected_amplitude_N"] / values["bead_9_amplitude_N"]


def speed_to_the_wall(run: Run) -> float:
    """Speed from bead 5 to the wall over that from bead 9 to bead 5 of Fig. 4, peak to peak."""
    one = _fig4(run)
    lower = one.case.layout.sensors[-1]
    to_wall = lower.height_m / (one.values["wall_arrival_s"] - one.values["bead_5_arrival_s"])
    return to_wall / speed_between_sensors(one)


def _face(run: Run) -> tuple[Array, Array, Array]:
    """Times, F_3 and the mean of F_3 and F_4 in bead 5 while the incident wave passes; F_4 is as far from the mean."""
    one, parts = _fig4(run), quoted().sensor
    forces, time = one.trace.force_N, one.trace.time_s
    passing = np.abs(time - one.values["bead_5_arrival_s"]) < 90e-6
    third, _ = theory.sensor_forces(forces[passing, 5], forces[passing, 4], parts.gauge_share)
    return time[passing], third, sensor_average(forces, 5)[passing]


def face_deviation(run: Run) -> float:
    """Largest deviation of F_3 and F_4 from their mean where that exceeds 2 % of its peak, per cent."""
    _, third, mean = _face(run)
    seen = mean > 0.02 * mean.max()
    return float(100 * np.abs(third / mean - 1)[seen].max())


def face_deviation_at_peak(run: Run) -> float:
    """Deviation of F_3 and F_4 from their mean where the mean peaks, per cent."""
    time, third, mean = _face(run)
    return float(100 * abs(CubicSpline(time, third / mean - 1)(peaks(time, mean)[0].time_s)))


def reflection(run: Run) -> float:
    """Wave reflected by one bead of a sensor's mass over the incident one, seen five beads above, per cent."""
    lighter = f"chain.bead=[{{ from_wall = 30, mass = '{quoted().sensor.mass_g} g' }}]"
    one = run(case_of("table1", *BARE, "chain.count=60", "chain.sensors=[]", "run.duration=1.6 ms", lighter))
    incident, back = waves(one, 35, at_least=2, prominence=1e-3)[:2]
    return 100 * back.value / incident.value


def _exact_fig4() -> Simulation:
    return exact(case_of("fig4"))


def momentum() -> float:
    """Momentum error on Fig. 4's scene before the wave reaches the wall, per cent of the largest momentum."""
    return 100 * _exact_fig4().values["momentum_error_before_wall_share"]


def energy() -> float:
    """Energy error over all times, per cent of the striker's energy."""
    one = _exact_fig4()
    return 100 * one.values["energy_drift_J"] / one.values["kinetic_energy_start_J"]
