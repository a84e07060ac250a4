"""What the paper says of pulses in chains, computed from full simulations by whichever engine ``run`` stands for."""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline

from drivers.case import Case
from drivers.chain import Array
from postproc.pulse import envelope, incident_pulse
from postproc.quoted import quoted
from postproc.sensors import sensor_average
from postproc.signals import Peak, peaks
from validation import theory
from validation.simulate import Simulation, case_of
from validation.strikes import contact_peak, static_force

Run = Callable[[Case], Simulation]

BARE = ("gravity=", "wall=")  # a chain that nothing compresses
SIGNIFICANT = 0.05  # of the first wave of a train
SMALL = 0.02  # prominence of the waves of a train, over the largest
HIGH, LOW = 1.9023, 0.0443  # striker speeds of the table's 5 and 0.06 N, m/s


def _contact(simulation: Simulation, j: int) -> tuple[Array, Array]:
    return simulation.trace.time_s, simulation.trace.force_N[:, j - 1]


def _waves(simulation: Simulation, contact: int, prominence: float = SMALL) -> list[Peak]:
    return peaks(*_contact(simulation, contact), prominence=prominence)


# --- one solitary wave ---


def exponent(run: Run) -> float:
    """Power of the force in the speed, from two strikes without gravity a factor of ten apart."""
    found = [run(case_of("table1", *BARE, f"striker.speed={speed} m/s")) for speed in (0.2, 2.0)]
    speeds, forces = [one.values["speed_9_to_5_m_s"] for one in found], [contact_peak(one) for one in found]
    return float(np.log(speeds[1] / speeds[0]) / np.log(forces[1] / forces[0]))


def width_ratio_bare(run: Run) -> float:
    """Width at 4 % without gravity: at the striker speed of the table's 0.06 N over that of its 5 N."""
    found = [run(case_of("table1", *BARE, f"striker.speed={v} m/s", "run.duration=2 ms")) for v in (LOW, HIGH)]
    low, high = (one.values["bead_5_width_4pct_diameters"] for one in found)
    return low / high


def width_by_modulus(run: Run) -> float:
    """Width at 4 % with gravity for 600 MPa over that for 1460 MPa, at strikes that give the same forces."""
    slower = HIGH * (1460 / 600) ** (1 / 3)  # F ~ k^(2/5) v^(6/5)
    strikes = ((600, slower), (1460, HIGH))
    found = [run(case_of("table1", f"materials.ptfe.youngs_modulus={modulus} MPa", f"striker.speed={speed!r} m/s"))
             for modulus, speed in strikes]  # fmt: skip
    soft, hard = (one.values["bead_5_width_4pct_diameters"] for one in found)
    return soft / hard


def width_by_gravity(run: Run) -> float:
    """Width at 4 % with gravity over that without, at the striker speed of the table's 0.06 N."""
    found = [run(case_of("table1", *off, f"striker.speed={LOW} m/s", "run.duration=2 ms")) for off in ((), BARE)]
    heavy, bare = (one.values["bead_5_width_4pct_diameters"] for one in found)
    return heavy / bare


def _speed_by_gravity(run: Run, speed: float) -> float:
    """Speed with gravity over that of the exponent 1/6 without it at the same peak force."""
    heavy, bare = (
        run(case_of("table1", *off, f"striker.speed={speed} m/s", "run.duration=2 ms")) for off in ((), BARE)
    )
    same_force = bare.values["speed_9_to_5_m_s"] * (contact_peak(heavy) / contact_peak(bare)) ** (1 / 6)
    return float(heavy.values["speed_9_to_5_m_s"] / same_force)


def gravity_low(run: Run) -> float:
    """By how much gravity speeds up the wave of the table's 0.06 N, per cent."""
    return 100 * (_speed_by_gravity(run, LOW) - 1)


def gravity_high(run: Run) -> float:
    """By how much gravity speeds up the wave of the table's 5 N, per cent."""
    return 100 * (_speed_by_gravity(run, HIGH) - 1)


def theory_and_chain(run: Run) -> float:
    """Largest deviation of Eq. (4) from simulated speeds with gravity, at strikes of 0.015 to 5 m/s, per cent."""
    found = []
    for speed in (0.015, 0.1, 0.7, 5.0):
        one = run(case_of("table1", f"striker.speed={speed} m/s"))
        particles = theory.particles_of(one.case)
        long_wave = theory.precompressed_speed(particles, contact_peak(one), static_force(one))
        found.append(abs(long_wave / one.values["speed_9_to_5_m_s"] - 1))
    return 100 * max(found)


def contact_force_high(run: Run) -> float:
    """Simulated peak contact force over that of Eq. (6) at the table's 5 N, beta being the solitary wave's."""
    return _contact_force(run, HIGH)


def contact_force_low(run: Run) -> float:
    """The same at the table's 0.06 N."""
    return _contact_force(run, LOW)


def _contact_force(run: Run, speed: float) -> float:
    from validation.reference.precompressed_wave import solve_at_amplitude

    one = run(case_of("table1", f"striker.speed={speed} m/s"))
    chain, static, peak = one.case.chain, static_force(one), contact_peak(one)
    wave = solve_at_amplitude(float(chain.stiffness[6]), float(chain.mass_kg[0]), static, peak / static - 1)
    average = (one.values["bead_9_amplitude_N"] + one.values["bead_5_amplitude_N"]) / 2
    return peak / theory.contact_force(wave.beta, average, static)


def slowest_speed(run: Run) -> float:
    """Simulated speed of the table's 0.06 N, m/s."""
    return run(case_of("table1", f"striker.speed={LOW} m/s")).values["speed_9_to_5_m_s"]


# --- Fig. 4 ---


def _fig4(run: Run) -> Simulation:
    return run(case_of("fig4", "run.duration=0.9 ms"))


def fig4_force(run: Run) -> float:
    """Peak of the sensor average in bead 9, N."""
    return _fig4(run).values["bead_9_peak_N"]


def fig4_speed(run: Run) -> float:
    """Speed from bead 9 to bead 5, m/s."""
    return _fig4(run).values["speed_9_to_5_m_s"]


def fig4_width(run: Run) -> float:
    """Width at bead 5 at 0.2 %, in diameters."""
    return _fig4(run).values["bead_5_width_0.2pct_diameters"]


def fig4_amplitudes(run: Run) -> float:
    """Peak of the sensor average in bead 9 over the quoted 2 N."""
    return fig4_force(run) / quoted().fig4.leading_force_N


def fig4_duration(run: Run) -> float:
    """Duration at bead 5 at 0.2 % of the peak, microseconds."""
    return _fig4(run).values["bead_5_duration_0.2pct_s"] * 1e6


def fig4_reflected(run: Run) -> float:
    """Reflected over incident peak in bead 9."""
    values = _fig4(run).values
    return values["bead_9_reflected_amplitude_N"] / values["bead_9_amplitude_N"]


def fig4_to_the_wall(run: Run) -> float:
    """Speed from bead 5 to the wall over that from bead 9 to bead 5, peak to peak."""
    one = _fig4(run)
    values, lower = one.values, one.case.layout.sensors[-1]
    to_wall = lower.height_m / (values["wall_arrival_s"] - values["bead_5_arrival_s"])
    return to_wall / values["speed_9_to_5_m_s"]


def _gauge_faces(run: Run) -> tuple[Array, Array, Array]:
    """Times, F_3 and the mean of F_3 and F_4 in bead 5 while the incident wave passes; F_4 is as far from the mean."""
    one, sensor = _fig4(run), quoted().sensor
    force, time = one.trace.force_N, one.trace.time_s
    passing = np.abs(time - one.values["bead_5_arrival_s"]) < 90e-6
    third, _ = theory.sensor_forces(force[passing, 5], force[passing, 4], sensor.caps_g, sensor.gauge_g)
    return time[passing], third, sensor_average(force, 5)[passing]


def gauge_faces(run: Run) -> float:
    """Largest deviation of F_3 and F_4 from their mean where that exceeds 2 % of its peak, per cent."""
    _, third, mean = _gauge_faces(run)
    seen = mean > 0.02 * mean.max()
    return float(100 * np.abs(third / mean - 1)[seen].max())


def gauge_faces_at_peak(run: Run) -> float:
    """Their deviation at the peak of the mean, per cent."""
    time, third, mean = _gauge_faces(run)
    return float(100 * abs(CubicSpline(time, third / mean - 1)(peaks(time, mean)[0].time_s)))


def sensor_reflection(run: Run) -> float:
    """Wave reflected by one lighter bead over the incident one, per cent: seen five beads above it, no gravity."""
    lighter = "chain.bead=[{ from_wall = 30, mass = '0.116 g' }]"
    one = run(case_of("table1", *BARE, "chain.count=60", "chain.sensors=[]", "run.duration=1.6 ms", lighter))
    incident, reflected = _waves(one, 35, prominence=1e-3)[:2]
    return 100 * reflected.value / incident.value


# --- trains, collisions, precompression ---


def single_wave(run: Run) -> float:
    """Second wave over the first, thirty beads below a striker like the beads, no gravity."""
    one = run(case_of("table1", *BARE, "chain.count=60", "run.duration=4 ms"))
    found = _waves(one, 30, prominence=1e-4)
    return found[1].value / found[0].value if len(found) > 1 else 0.0


def _heavy_strike(run: Run, *settings: str) -> Simulation:
    return run(case_of("fig5", "gravity=", "chain.count=60", "run.duration=2.4 ms", *settings))


def train_count(run: Run) -> float:
    """Waves above 5 % of the first, thirty beads below Fig. 5's striker, no gravity."""
    return _count(_waves(_heavy_strike(run), 31))


def _count(train: list[Peak]) -> float:
    """How many waves of a train exceed ``SIGNIFICANT`` of its first, before one rises again: a reflected wave."""
    rising = next((i for i in range(1, len(train)) if train[i].value > train[i - 1].value), len(train))
    return float(sum(peak.value > SIGNIFICANT * train[0].value for peak in train[:rising]))


def splitting(run: Run) -> float:
    """Valley between the first two waves over the second, ten beads below Fig. 5's striker, no gravity."""
    one = _heavy_strike(run)
    first, second = _waves(one, 51)[:2]
    return float(_contact(one, 51)[1][first.sample : second.sample].min() / second.value)


def fig5_count(run: Run) -> float:
    """Waves that reach the wall in Fig. 5, above 5 % of the first, before the reflected one."""
    return _count(_waves(run(case_of("fig5")), 1))


def collision(run: Run) -> float:
    """Secondary wave over the original ones after two equal waves met at a contact, no gravity."""
    ends = "chain.bead=[{ from_wall = 1, velocity = '1 m/s' }, { from_wall = 80, velocity = '-1 m/s' }]"
    one = run(case_of("table1", *BARE, "striker=", "chain.count=80", "chain.sensors=[]", ends, "run.duration=2.6 ms"))
    found = _waves(one, 61, prominence=1e-3)  # the wave from above, that from below, and what follows it
    return found[2].value / found[0].value


def _piston(run: Run) -> tuple[Simulation, Simulation]:
    """Fig. 5's striker on a chain without and with a static force of 0.5 N."""
    gauges = "chain.sensors=[{ from_wall = 50 }, { from_wall = 45 }]"
    return _heavy_strike(run, gauges), _heavy_strike(run, gauges, "chain.precompression=0.5 N")


def precompression_speed(run: Run) -> float:
    """Speed of the leading wave under 0.5 N over that without, ten to fifteen beads below the striker."""
    bare, pressed = _piston(run)
    return pressed.values["speed_50_to_45_m_s"] / bare.values["speed_50_to_45_m_s"]


def precompression_splitting(run: Run) -> float:
    """Depth of the valley after the first wave over its height, under 0.5 N over that without."""
    depths = []
    for one in _piston(run):
        signal = sensor_average(one.trace.force_N, 45)
        dynamic = signal - signal[0]
        first, second = peaks(one.trace.time_s, dynamic, prominence=1e-3)[:2]
        depths.append(1 - dynamic[first.sample : second.sample].min() / first.value)
    return float(depths[1] / depths[0])


def precompression_width(run: Run) -> float:
    """Width of the leading wave at half its peak in diameters, under 0.5 N over that without."""
    from postproc.observables import observe

    found = [observe(one.case.layout, one.trace, (0.5,))["bead_45_width_50pct_diameters"] for one in _piston(run)]
    return found[1] / found[0]


# --- Figs. 5 and 6 ---


def fig5_envelope(run: Run) -> float:
    """Rate of the exponential through the first three maxima at the wall, per microsecond."""
    one = run(case_of("fig5"))
    return envelope(_waves(one, 1, prominence=0.05)[:3]).rate_per_s / 1e6


def _entrance(run: Run, bead: int = 11) -> tuple[float, float, float]:
    """Rise, decay and duration of the incident pulse, in microseconds."""
    one = run(case_of("fig5"))
    signal = sensor_average(one.trace.force_N, bead)
    shape = incident_pulse(one.trace.time_s, signal - signal[0])
    return shape.rise_s * 1e6, shape.decay_per_s / 1e6, shape.duration_s * 1e6


def fig5_rise(run: Run) -> float:
    """Rise of the averaged force at the top bead, microseconds."""
    return _entrance(run)[0]


def fig5_decay(run: Run) -> float:
    """Rate of its initial decay, per microsecond."""
    return _entrance(run)[1]


def fig5_duration(run: Run) -> float:
    """Its duration, microseconds."""
    return _entrance(run)[2]


def fig5_decay_ratio(run: Run) -> float:
    """The incident pulse's rate of decay over the envelope's."""
    return fig5_decay(run) / fig5_envelope(run)


def fig6d_count(run: Run) -> float:
    """Waves that reach the wall in Fig. 6d, above 5 % of the first, before the reflected one."""
    return _count(_waves(run(case_of("fig6d")), 1, prominence=0.005))


COMPUTED = {
    "eq3-exponent": exponent,
    "width-without-gravity": width_ratio_bare,
    "width-modulus": width_by_modulus,
    "width-by-gravity": width_by_gravity,
    "gravity-low": gravity_low,
    "gravity-high": gravity_high,
    "fig3-theory": theory_and_chain,
    "eq6-force": contact_force_high,
    "eq6-force-low": contact_force_low,
    "fig4-force": fig4_force,
    "fig4-speed": fig4_speed,
    "fig4-width": fig4_width,
    "fig4-amplitudes-agree": fig4_amplitudes,
    "fig4-duration": fig4_duration,
    "fig4-reflected": fig4_reflected,
    "fig4-to-wall": fig4_to_the_wall,
    "eq5-deviation": gauge_faces,
    "eq5-at-peak": gauge_faces_at_peak,
    "sensor-reflection": sensor_reflection,
    "single-wave": single_wave,
    "train-count": train_count,
    "train-splitting": splitting,
    "fig5-count": fig5_count,
    "collision-secondary": collision,
    "precompression-speed": precompression_speed,
    "precompression-splitting": precompression_splitting,
    "precompression-width": precompression_width,
    "fig5-envelope": fig5_envelope,
    "fig5-envelope-measured": fig5_envelope,
    "measured-speeds": slowest_speed,
    "fig5-rise": fig5_rise,
    "fig5-decay": fig5_decay,
    "fig5-duration": fig5_duration,
    "fig5-decay-ratio": fig5_decay_ratio,
    "fig6d-count": fig6d_count,
}
