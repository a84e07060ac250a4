"""Claims on simulated chains: single waves, Fig. 4, trains, Fig. 5, static forces; ``run`` stands for any engine.

On Table 1: rows of its solved numerical half, and which modulus its measured speeds speak for.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.chain.chain import Array
from postproc.paper import theory
from postproc.paper.quoted import quoted
from postproc.paper.simulate import UNTIL_REFLECTED, Simulation, case_of, exact
from postproc.paper.strikes import (
    READINGS,
    contact_peak,
    deviations,
    engines_of,
    sensor_amplitude,
    speed_between_sensors,
    static_force,
    strike_for,
    striker_speed,
)
from postproc.read.observables import observe
from postproc.read.sensors import sensor_average
from postproc.read.signals import Peak, incident_pulse, peaks
from validation.reference.travelling_wave import solve_at_amplitude

Run = Callable[[Case], Simulation]

BARE = ("gravity=", "wall=")  # a chain that nothing compresses
PROMINENCE = 0.005  # of a force's range: by so much a wave of a train stands out
COUNTED_SHARE = 0.05  # of the first wave of a train: waves that count
LONG = "run.duration=2 ms"
WIDTH = "bead_5_width_4pct_diameters"
MICRO = 1e6
ROWS = {"large": slice(0, 2), "small": slice(2, None)}  # of the table: 5 and 2 N; 0.6, 0.1 and 0.06 N


def _waves(simulation: Simulation, contact: int, at_least: int = 1, prominence: float = PROMINENCE) -> list[Peak]:
    """The waves that pass a contact.

    Raises:
        InputError: fewer than ``at_least`` within the scene's duration.
    """
    trace = simulation.trace
    found = peaks(trace.time_s, trace.force_N[:, contact - 1], prominence=prominence)
    if len(found) < at_least:
        words = f"{len(found)} waves at contact {contact} within it"
        raise InputError(simulation.case.scene.file, "run.duration", words, f"long enough for {at_least}")
    return found


def _significant(train: list[Peak]) -> float:
    """How many waves of a train exceed ``COUNTED_SHARE`` of its first, before one rises again: a reflected wave."""
    rising = next((i for i in range(1, len(train)) if train[i].value > train[i - 1].value), len(train))
    return float(sum(peak.value > COUNTED_SHARE * train[0].value for peak in train[:rising]))


def _struck(run: Run, force_N: float, *settings: str) -> Simulation:
    """Table 1's chain under the strike that gives one of its amplitudes, or the same strike on a changed chain."""
    return run(case_of("table1", f"striker.speed={_striker_speed(force_N)!r} m/s", *settings))


@cache
def _striker_speed(force_N: float) -> float:
    """The striker speed that gives an amplitude of Table 1, m/s."""
    return striker_speed(strike_for(force_N, sensor_amplitude))


def exponent(run: Run) -> float:
    """Power of the force in the speed, from two strikes without gravity a factor of ten apart."""
    found = [run(case_of("table1", *BARE, f"striker.speed={speed} m/s")) for speed in (0.2, 2.0)]
    speeds, forces = [speed_between_sensors(one) for one in found], [contact_peak(one) for one in found]
    return float(np.log(speeds[1] / speeds[0]) / np.log(forces[1] / forces[0]))


def width_by_amplitude(run: Run, low_N: float, high_N: float) -> float:
    """Width at 4 % without gravity: under the strike of the table's 0.06 N over that under the strike of its 5 N."""
    low, high = (_struck(run, force, *BARE, LONG).values[WIDTH] for force in (low_N, high_N))
    return low / high


def width_by_modulus(run: Run, force_N: float) -> float:
    """Width at 4 % with gravity for the softest over that for the hardest modulus, at strikes of the same force."""
    soft, hard = min(quoted().ptfe.moduli_MPa), max(quoted().ptfe.moduli_MPa)
    speed = _striker_speed(force_N) * (hard / soft) ** (1 / 3)  # F ~ k^(2/5) v^(6/5)
    settings = (f"materials.ptfe.youngs_modulus={soft} MPa", f"striker.speed={speed!r} m/s")
    return run(case_of("table1", *settings)).values[WIDTH] / _struck(run, force_N).values[WIDTH]


def width_by_gravity(run: Run, force_N: float) -> float:
    """Width at 4 % with gravity over that without, under the strike of the table's 0.06 N."""
    heavy, bare = (_struck(run, force_N, LONG, *off).values[WIDTH] for off in ((), BARE))
    return heavy / bare


def speed_by_gravity(run: Run, force_N: float) -> float:
    """Speed with gravity over that of the exponent 1/6 without it at the same peak force, less 1, per cent."""
    heavy, bare = (_struck(run, force_N, LONG, *off) for off in ((), BARE))
    same_force = speed_between_sensors(bare) * (contact_peak(heavy) / contact_peak(bare)) ** (1 / 6)
    return float(100 * (speed_between_sensors(heavy) / same_force - 1))


def theory_and_chain(run: Run) -> float:
    """Largest deviation of Eq. (4) from simulated speeds with gravity, at strikes of 0.015 to 5 m/s, per cent."""
    found = []
    for speed in (0.015, 0.1, 0.7, 5.0):
        one = run(case_of("table1", f"striker.speed={speed} m/s"))
        particles = theory.particles_of(one.case)
        long_wave = theory.precompressed_speed(particles, contact_peak(one), static_force(one.case))
        found.append(abs(long_wave / speed_between_sensors(one) - 1))
    return 100 * max(found)


def contact_force(run: Run, force_N: float) -> float:
    """Simulated peak contact force over that of Eq. (6), beta being the solitary wave's."""
    one = _struck(run, force_N)
    chain, static, peak = one.case.chain, static_force(one.case), contact_peak(one)
    wave = solve_at_amplitude(float(chain.stiffness[6]), float(chain.mass_kg[0]), static, peak / static - 1)
    return peak / theory.contact_force(wave.beta, sensor_amplitude(one), static)


def strike_speed(run: Run, force_N: float) -> float:
    """Simulated speed at the table's 0.06 N, m/s."""
    return speed_between_sensors(_struck(run, force_N))


def _fig4(run: Run) -> Simulation:
    return run(case_of("fig4", UNTIL_REFLECTED))


def fig4(run: Run, observable: str, over: str = "", times: float = 1.0) -> float:
    """An observable of Fig. 4's chain, maybe over another, times a number."""
    values = _fig4(run).values
    return values[observable] / (values[over] if over else 1.0) * times


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
    third, _ = theory.sensor_forces(forces[passing, 5], forces[passing, 4], parts.gauge_g / parts.mass_g)
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
    incident, back = _waves(one, 35, at_least=2, prominence=1e-3)[:2]
    return 100 * back.value / incident.value


def conservation_error(error: str, of: str = "") -> float:
    """An error on Fig. 4's scene, per cent."""
    values = exact(case_of("fig4")).values
    return 100 * values[error] / (values[of] if of else 1.0)


def single_wave(run: Run) -> float:
    """Largest force after the first wave over that wave's, thirty beads below a striker like the beads, no gravity."""
    one = run(case_of("table1", *BARE, "chain.count=60", "run.duration=4 ms"))
    first = _waves(one, 30)[0]
    force = one.trace.force_N[first.sample :, 29]
    passed = int((force < 1e-3 * first.value).argmax())  # the first wave's own tail does not count
    return float(force[passed:].max() / first.value)


def collision(run: Run) -> float:
    """Secondary wave over the original ones after two equal waves met at a contact, no gravity."""
    ends = "chain.bead=[{ from_wall = 1, velocity = '1 m/s' }, { from_wall = 80, velocity = '-1 m/s' }]"
    one = run(case_of("table1", *BARE, "striker=", "chain.count=80", "chain.sensors=[]", ends, "run.duration=2.6 ms"))
    found = _waves(one, 61, at_least=3, prominence=1e-3)  # from above, from below, and what follows
    return found[2].value / found[0].value


def _heavy_strike(run: Run, *settings: str) -> Simulation:
    """Fig. 5's striker on sixty beads without gravity."""
    return run(case_of("fig5", "gravity=", "chain.count=60", "run.duration=2.4 ms", *settings))


def train_count(run: Run) -> float:
    """Waves above 5 % of the first, thirty beads below Fig. 5's striker, no gravity."""
    return _significant(_waves(_heavy_strike(run), 31))


def splitting(run: Run) -> float:
    """Valley between the first two waves over the second, ten beads below Fig. 5's striker, no gravity."""
    one = _heavy_strike(run)
    first, second = _waves(one, 51, at_least=2)[:2]
    return float(one.trace.force_N[first.sample : second.sample, 50].min() / second.value)


def count_at_wall(run: Run, scene: str) -> float:
    """Waves that reach the wall, above 5 % of the first, before the reflected one."""
    return _significant(_waves(run(case_of(scene)), 1))


def _piston(run: Run) -> tuple[Simulation, Simulation]:
    """Fig. 5's striker on a chain without and with a static force of 0.5 N."""
    gauges = "chain.sensors=[{ from_wall = 50 }, { from_wall = 45 }]"
    return _heavy_strike(run, gauges), _heavy_strike(run, gauges, "chain.precompression=0.5 N")


def precompression_speed(run: Run) -> float:
    """Speed of the leading wave under 0.5 N over that without, ten to fifteen beads below the striker."""
    bare, pressed = _piston(run)
    return speed_between_sensors(pressed) / speed_between_sensors(bare)


def precompression_splitting(run: Run) -> float:
    """Depth of the valley after the first wave over its height, under 0.5 N over that without."""
    depths = []
    for one in _piston(run):
        reading = sensor_average(one.trace.force_N, 45)
        dynamic = reading - reading[0]
        first, second = peaks(one.trace.time_s, dynamic, prominence=1e-3)[:2]
        depths.append(1 - dynamic[first.sample : second.sample].min() / first.value)
    return float(depths[1] / depths[0])


def precompression_width(run: Run) -> float:
    """Width of the leading wave at half its peak in diameters, under 0.5 N over that without."""
    found = [observe(one.case.layout, one.trace, (0.5,))["bead_45_width_50pct_diameters"] for one in _piston(run)]
    return found[1] / found[0]


def envelope_rate(run: Run) -> float:
    """Rate of the exponential through the first three maxima at the wall in Fig. 5, per microsecond."""
    return run(case_of("fig5")).values["wall_envelope_per_s"] / MICRO


def entrance(run: Run, number: str, times: float) -> float:
    """A number of the averaged force at the top bead of Fig. 5, in the unit that a factor makes of SI's."""
    one = run(case_of("fig5"))
    reading = sensor_average(one.trace.force_N, one.case.chain.beads)
    shape = incident_pulse(one.trace.time_s, reading - reading[0])
    if shape is None:
        raise InputError(one.case.scene.file, "run.duration", "no reflected wave within it", "until the wave is back")
    return float(getattr(shape, number) * times)


def decay_ratio(run: Run) -> float:
    """Rate of decay of the incident pulse at the top bead over that of the envelope at the wall."""
    return entrance(run, "decay_per_s", 1 / MICRO) / envelope_rate(run)


def solved(table: pd.DataFrame, force_N: float, column: str) -> dict[str, float]:
    """A column by every engine, of the strike that gives this amplitude."""
    row = next(row for row in table.to_dict("records") if row["force_N"] == force_N)
    return {engine: row[f"{engine}_{column}"] for engine in engines_of(table)}


def misfit(modulus_MPa: float, forces: str, force_is: str = "contact force") -> float:
    """Measured speed off the simulated, root mean square over some forces, per cent."""
    return float(100 * np.sqrt((deviations(modulus_MPa, READINGS[force_is])[ROWS[forces]] ** 2).mean()))


def nearest(forces: str, force_is: str) -> float:
    """The modulus whose simulated speeds are nearest to the measured ones, MPa."""
    return min(quoted().ptfe.moduli_MPa, key=lambda modulus: misfit(modulus, forces, force_is))


def softer_is_worse() -> float:
    """Measured speed off the simulated at 5 N for 400 MPa over the same for 600 MPa."""
    return float(deviations(400, contact_peak)[0] / deviations(600, contact_peak)[0])
