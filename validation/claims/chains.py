"""Statements on chains: single waves and trains, under strikes, in Table 1 and the figures, elastic or calibrated.

``run`` is the function that runs a case on an engine.
"""

from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline

from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.chain.chain import Array
from postproc.paper import calibrated, quoted, strikes
from postproc.read.motion import UNTIL_REFLECTED, Simulation, case_of, exact
from postproc.read.observables import envelope, observe
from postproc.read.signals import ONSET, Peak, incident_pulse, integral, peaks, sensor_average
from validation.claims.equations import sound_speed
from validation.reference.travelling_wave import solve_at_amplitude, solve_travelling_wave

Run = Callable[[Case], Simulation]

MICRO = 1e6
UNCOMPRESSED = ("gravity=", "wall=")
LONG_DURATION = "run.duration=2 ms"
PROMINENCE = 0.005  # of a wave in a train, divided by the range of the force
COARSE = ("run.time_step=0.2 us", "run.sample_interval=2 us")  # for long chains: errors of waves up to 1e-4
WIDTH = "bead_5_width_4pct_diameters"
READINGS = {
    "average of the sensors": strikes.sensor_amplitude,
    "contact force": strikes.contact_peak,
}  # of F_m in Table 1
ROWS = {"large": slice(0, 2), "small": slice(2, None)}  # of the table: 5 and 2 N; 0.6, 0.1 and 0.06 N
ELASTIC, FITTED, SOFTENED = "elastic", "fitted", "fitted, without dissipation"
FIG4_DURATION = {ELASTIC: UNTIL_REFLECTED, FITTED: "run.duration=1.4 ms"}  # until the reflected wave has passed


def of_law(scene: str, law: str, *settings: str) -> Case:
    """A scene with the elastic law of the paper, or with the calibrated one, with or without its dissipation."""
    fitted = () if law == ELASTIC else calibrated().settings
    return case_of(scene, *fitted, *settings, *(["contact.restitution="] if law == SOFTENED else ()))


def waves(simulation: Simulation, contact: int, at_least: int = 1, prominence: float = PROMINENCE) -> list[Peak]:
    """Waves that pass a contact.

    Raises:
        InputError: fewer than ``at_least`` within the scene's duration.
    """
    trace = simulation.trace
    passing = peaks(trace.time_s, trace.force_N[:, contact - 1], prominence=prominence)
    if len(passing) < at_least:
        few = f"a run with {len(passing)} waves at contact {contact}"
        raise InputError(simulation.case.scene.file, "run.duration", few, f"a duration with {at_least}")
    return passing


def struck(run: Run, force_N: float, *settings: str) -> Simulation:
    """Table 1's chain under the strike for one of the amplitudes; settings change the chain, not the strike."""
    return run(case_of("table1", strike_of(force_N), *settings))


def strike_of(force_N: float) -> str:
    """Setting of the strike for an amplitude of Table 1."""
    return f"striker.speed={strikes.striker_speed(_strike(force_N, strikes.sensor_amplitude))!r} m/s"


_strike = cache(strikes.strike_for)


def exponent(run: Run) -> float:
    """Exponent of the force in the speed, from two strikes without gravity, a factor of ten apart."""
    motions = [run(case_of("table1", *UNCOMPRESSED, f"striker.speed={speed} m/s")) for speed in (0.2, 2.0)]
    speeds, forces = [*map(strikes.speed_between_sensors, motions)], [*map(strikes.contact_peak, motions)]
    return float(np.log(speeds[1] / speeds[0]) / np.log(forces[1] / forces[0]))


def width_by_modulus(run: Run, force_N: float) -> float:
    """Width at 4 % with gravity for the softest modulus divided by that for the hardest, at strikes of equal force."""
    soft, hard = min(quoted().ptfe_moduli_MPa), max(quoted().ptfe_moduli_MPa)
    equal = (hard / soft) ** (1 / 3)  # F ~ k^(2/5) v^(6/5)
    speed = strikes.striker_speed(_strike(force_N, strikes.sensor_amplitude)) * equal
    settings = (f"materials.ptfe.youngs_modulus={soft} MPa", f"striker.speed={speed!r} m/s")
    return run(case_of("table1", *settings)).values[WIDTH] / struck(run, force_N).values[WIDTH]


def widening(run: Run, force_N: float, gravity: bool, over_N: float, over_gravity: bool, width: str = WIDTH) -> float:
    """Width under a strike of Table 1, with or without gravity, divided by that under another one."""
    strikes_N = ((force_N, gravity), (over_N, over_gravity))
    settings = [(force, *(() if heavy else UNCOMPRESSED), LONG_DURATION) for force, heavy in strikes_N]
    first, second = (struck(run, *each).values[width] for each in settings)
    return first / second


def speed_by_gravity(run: Run, force_N: float) -> float:
    """Speed with gravity divided by that of the exponent 1/6 without it at the same peak force, less 1, per cent."""
    motions = [struck(run, force_N, LONG_DURATION, *off) for off in ((), UNCOMPRESSED)]
    speed, bare_speed = map(strikes.speed_between_sensors, motions)
    peak, bare_peak = map(strikes.contact_peak, motions)
    return float(100 * (speed / (bare_speed * (peak / bare_peak) ** (1 / 6)) - 1))


def theory_and_chain(run: Run) -> float:
    """Largest deviation of Eq. (4) from simulated speeds with gravity, at strikes of 0.015 to 5 m/s, per cent."""
    motions = [run(case_of("table1", f"striker.speed={speed} m/s")) for speed in (0.015, 0.1, 0.7, 5.0)]
    by_theory = [_long_wave_speed(motion, strikes.contact_peak(motion)) for motion in motions]
    speeds = map(strikes.speed_between_sensors, motions)
    return 100 * max(abs(theirs / ours - 1) for theirs, ours in zip(by_theory, speeds, strict=True))


def _long_wave_speed(motion: Simulation, peak_N: float) -> float:
    return strikes.precompressed_speed(strikes.particles_of(motion.case), peak_N, strikes.static_force(motion.case))


def theory_and_experiment(run: Run, force_is: str) -> float:
    """Deviation of the measured speeds from Eq. (4) for 1460 MPa, root mean square over 5 and 2 N, per cent."""
    table, rows, off = quoted().table1, ROWS["large"], []
    for force_N, measured_m_s in zip(table["force_N"][rows], table["measured_speed_m_s"][rows], strict=True):
        motion = struck(run, force_N)
        peak_N = force_N if force_is == "contact force" else strikes.contact_peak(motion)
        off.append(measured_m_s / _long_wave_speed(motion, peak_N) - 1)
    return float(100 * np.sqrt(np.mean(np.square(off))))


def contact_force(run: Run, force_N: float) -> float:
    """Simulated peak contact force divided by that of Eq. (6), beta being the solitary wave's."""
    motion = struck(run, force_N)
    chain, static, peak = motion.case.chain, strikes.static_force(motion.case), strikes.contact_peak(motion)
    wave = solve_at_amplitude(float(chain.stiffness[6]), float(chain.mass_kg[0]), static, peak / static - 1)
    return peak / (wave.beta * strikes.sensor_amplitude(motion) + static)


def _fig4(run: Run, law: str = ELASTIC) -> Simulation:
    return run(of_law("fig4", law, FIG4_DURATION[law]))


def fig4(run: Run, observable: str, less: str = "", over: str = "", times: float = 1.0, law: str = ELASTIC) -> float:
    """An observable of Fig. 4's chain, less another, divided by a third, times a number."""
    values = _fig4(run, law).values
    difference = values[observable] - (values[less] if less else 0.0)
    return times * (difference / (values[over] if over else 1.0))


def speed_to_the_wall(run: Run) -> float:
    """Speed from bead 5 to the wall divided by that from bead 9 to bead 5 of Fig. 4, peak to peak."""
    motion = _fig4(run)
    lower = motion.case.layout.sensors[-1]
    to_wall = lower.height_m / (motion.values["wall_arrival_s"] - motion.values["bead_5_arrival_s"])
    return to_wall / strikes.speed_between_sensors(motion)


def face_deviation(run: Run, at_peak: bool = False) -> float:
    """Largest deviation of F_3 and F_4 from their mean, where the mean exceeds 2 % of its peak, per cent.

    In bead 5 of Fig. 4 while the incident wave passes; or at the peak of the mean. F_4 deviates as much as F_3.
    """
    motion, paper = _fig4(run), quoted()
    passing = np.abs(motion.trace.time_s - motion.values["bead_5_arrival_s"]) < 90e-6
    time, forces = motion.trace.time_s[passing], motion.trace.force_N[passing]
    mean = sensor_average(forces, 5)
    third = mean + (forces[:, 5] - forces[:, 4]) / 2 * (paper.sensor_gauge_g / paper.sensor_mass_g)  # Eq. (5)
    off = third / mean - 1
    if at_peak:
        return float(100 * abs(CubicSpline(time, off)(peaks(time, mean)[0].time_s)))
    return float(100 * np.abs(off)[mean > 0.02 * mean.max()].max())


def reflection(run: Run, incident_N: float) -> float:
    """Wave that one bead of a sensor's mass reflects, five beads above it, for an incident wave of some force, N."""
    lighter = f"chain.bead=[{{ from_wall = 30, mass = '{quoted().sensor_mass_g} g' }}]"
    settings = ("chain.count=60", "chain.sensors=[]", "run.duration=1.6 ms", *COARSE, lighter)
    motion = run(case_of("table1", *UNCOMPRESSED, *settings))
    incident, back = waves(motion, 35, at_least=2, prominence=1e-3)[:2]
    return incident_N * back.value / incident.value  # without gravity forces scale


def conservation_error(_: Run, error: str, of: str = "") -> float:
    """An error on Fig. 4's scene, per cent."""
    values = exact(case_of("fig4")).values
    return 100 * values[error] / (values[of] if of else 1.0)


def single_wave(run: Run) -> float:
    """Second wave divided by the first, thirty beads below a striker like the beads, no gravity; 0 without one."""
    motion = run(case_of("table1", *UNCOMPRESSED, "chain.count=60", "run.duration=4 ms", *COARSE))
    train = waves(motion, 30, prominence=1e-6)
    return train[1].value / train[0].value if len(train) > 1 else 0.0


def collision(run: Run, beads: float, seen: str, away: float) -> float:
    """Secondary wave divided by the original waves that met, some contacts away, as a force or as a velocity.

    The waves meet at a contact if the number of beads is even, else at a bead.
    """
    count = round(beads)
    ends = f"chain.bead=[{{ from_wall = 1, velocity = '1 m/s' }}, {{ from_wall = {count}, velocity = '-1 m/s' }}]"
    chain = ("striker=", f"chain.count={count}", "chain.sensors=[]", ends, "run.duration=2.6 ms", *COARSE)
    motion = run(case_of("table1", *UNCOMPRESSED, *chain))
    place, velocity = (count + 1) // 2 + round(away), motion.trace.velocity_m_s
    if seen == "force":  # from above, from below, and the secondary one
        first, _, secondary = waves(motion, place + 1, at_least=3, prominence=1e-3)[:3]
    else:  # from below, and the secondary one
        assert velocity is not None
        first, secondary = peaks(motion.trace.time_s, velocity[:, place], prominence=1e-3)[:2]
    return secondary.value / first.value


def table1(run: Run, force_N: float, column: str, beads: float, force_is: str, rounded: bool = False) -> float:
    """A column of Table 1 for the strike that gives this amplitude on the engine."""
    amplitude, setting = READINGS[force_is], f"chain.count={beads:g}"
    solved_N = strikes.fitting_force(force_N, setting) if rounded else force_N
    case = _strike(solved_N, amplitude, setting).case
    motion = run(case)
    if amplitude is strikes.sensor_amplitude:
        (motion,) = strikes.settled(lambda cases: [*map(run, cases)], [case], [solved_N])
    return strikes.table1_numbers(motion)[strikes.COLUMNS.index(column)]


def misfit(_: Run, modulus_MPa: float, forces: str, force_is: str) -> float:
    """Deviation of measured from simulated speeds at equal amplitudes, root mean square over some forces, per cent."""
    points = strikes.score(modulus_MPa, READINGS[force_is])[ROWS[forces]]
    off = points["measured_m_s"].to_numpy() / points["simulated_m_s"].to_numpy() - 1
    return float(100 * np.sqrt((off**2).mean()))


def width_by_diameter(run: Run) -> float:
    """Width in diameters at 4 % on the smaller beads divided by that on the larger ones, without gravity."""
    small = [f"{body}.{size}" for body in ("chain", "striker") for size in ("diameter=2.38 mm", "mass=0.0157 g")]
    first, second = (run(case_of("table1", *UNCOMPRESSED, *settings)).values[WIDTH] for settings in (small, ()))
    return first / second


def impulse_to_peak(run: Run) -> float:
    """Impulse on the wall up to the largest force, divided by the momentum of the steel ball that strikes it."""
    speed = 0.5
    ball = ("chain.count=1", "chain.material=stainless-steel", "chain.sensors=[]", "chain.mass=0.5 g", "striker=")
    moving = f"chain.bead=[{{ from_wall = 1, velocity = '-{speed} m/s' }}]"
    times = ("run.duration=60 us", "run.sample_interval=0.1 us", "run.time_step=0.01 us")
    motion = run(case_of("table1", "gravity=", *ball, moving, *times))
    time, force = motion.trace.time_s, motion.trace.force_N[:, 0]
    until_peak = CubicSpline(time, integral(time, force))(peaks(time, force)[0].time_s)
    return float(until_peak / (motion.case.chain.mass_kg[0] * speed))


def long_loading(run: Run) -> float:
    """Reading of a sensor bead between wall and a piston of 1 kg, divided by the force on the wall, peak by peak."""
    bead = ("chain.count=1", "chain.sensors=[{ from_wall = 1, mass = '0.116 g' }]")
    piston = ("striker.shape=flat", "striker.material=alumina", "striker.diameter=", "striker.mass=1 kg")
    slow = ("striker.speed=5 mm/s", "run.duration=20 ms", "run.sample_interval=5 us", "run.time_step=1 us")
    motion = run(case_of("table1", *bead, *piston, *slow))
    reading, wall = sensor_average(motion.trace.force_N, 1), motion.trace.force_N[:, 0]
    return peaks(motion.trace.time_s, reading)[0].value / peaks(motion.trace.time_s, wall)[0].value


def heavy_strike(run: Run, *settings: str) -> Simulation:
    """Fig. 5's striker on sixty beads without gravity."""
    chain = ("gravity=", "chain.count=60", "run.duration=2.4 ms", *COARSE)
    return run(case_of("fig5", *chain, *settings))


def rate_through(train: list[Peak], maxima: float) -> float:
    """Rate of the exponential through a train's first maxima, per microsecond."""
    return envelope(train[: round(maxima)])[0] / MICRO


def _significant(train: list[Peak], share: float) -> float:
    """Number of waves above a share of the first, before a larger one follows (the reflected wave)."""
    rising = next((i for i in range(1, len(train)) if train[i].value > train[i - 1].value), len(train))
    return float(sum(peak.value > share * train[0].value for peak in train[:rising]))


def small_waves(run: Run, share: float) -> float:
    """Waves above a share of the first divided by those above 5 %, thirty beads below Fig. 5's striker, no gravity."""
    train = waves(heavy_strike(run, "chain.count=100", "run.duration=6 ms", "run.time_step=1 us"), 71, prominence=1e-3)
    return _significant(train, share) / _significant(train, 0.05)


def _valley(motion: Simulation, contact: int) -> float:
    """Least force between the first two waves that pass a contact, divided by the second."""
    first, second = waves(motion, contact, at_least=2)[:2]
    return float(motion.trace.force_N[first.sample : second.sample, contact - 1].min() / second.value)


def splitting(run: Run, below: float) -> float:
    """Valley between the first two waves divided by the second, some beads below Fig. 5's striker, no gravity."""
    return _valley(heavy_strike(run, "run.sample_interval=0.2 us"), 61 - round(below))


def count_at_wall(run: Run, scene: str, share: float) -> float:
    """Waves that reach the wall, above a share of the first, before the reflected one."""
    return _significant(waves(run(case_of(scene)), 1), share)


def _dynamic(motion: Simulation, bead: int) -> Array:
    """Averaged force in a bead above the static one."""
    reading = sensor_average(motion.trace.force_N, bead)
    return np.asarray(reading - reading[0])


def precompression(run: Run, of: str) -> float:
    """Leading wave ten to fifteen beads below Fig. 5's striker under 0.5 N divided by that without static force.

    Its speed, the depth of the valley behind it divided by its height, or its width at half its peak in diameters.
    """
    values = []
    for static in ((), ("chain.precompression=0.5 N",)):
        motion = heavy_strike(run, "chain.sensors=[{ from_wall = 50 }, { from_wall = 45 }]", *static)
        dynamic = _dynamic(motion, 45)
        first, second = peaks(motion.trace.time_s, dynamic, prominence=1e-3)[:2]
        depth = 1 - dynamic[first.sample : second.sample].min() / first.value
        width = observe(motion.case.layout, motion.trace, (0.5,))["bead_45_width_50pct_diameters"]
        values.append({"speed": strikes.speed_between_sensors(motion), "valley": depth, "width": width}[of])
    return float(values[1] / values[0])


def envelope_rate(run: Run, maxima: float, law: str = ELASTIC) -> float:
    """Rate of the exponential through the first maxima at the wall in Fig. 5, per microsecond."""
    return rate_through(waves(run(of_law("fig5", law)), 1), maxima)


def envelope_by_place(run: Run, bead: float) -> float:
    """Rate through the first two maxima in a bead of Fig. 5 divided by that at the wall."""
    motion = run(case_of("fig5"))
    return rate_through(peaks(motion.trace.time_s, _dynamic(motion, round(bead))), 2) / envelope_rate(run, 2)


def entrance(run: Run, number: str, times: float, bead: float, onset: float = ONSET) -> float:
    """A number of the incident pulse, from the averaged force in a bead of Fig. 5, in SI units times a factor."""
    motion = run(case_of("fig5"))
    shape = incident_pulse(motion.trace.time_s, _dynamic(motion, round(bead)), onset)
    if not shape:
        raise InputError(motion.case.scene.file, "run.duration", "a run without the reflected wave", "a longer run")
    return float(shape[number] * times)  # NaN for the duration of a pulse that does not end


def decay_ratio(run: Run, bead: float, maxima: float) -> float:
    """Rate of decay of the pulse that enters at a bead divided by that of the envelope at the wall."""
    return entrance(run, "decay_per_s", 1 / MICRO, bead) / envelope_rate(run, maxima)


def _long_impact(run: Run) -> Simulation:
    """Sixty beads under a striker of 1 kg, 8000 of their masses, no gravity."""
    return heavy_strike(run, "striker.mass=1 kg")


def oscillations(run: Run) -> float:
    """Maxima of a long impact before the reflected wave, thirty beads below the striker."""
    return _significant(waves(_long_impact(run), 30), 0.0)


def leading_speed(run: Run) -> float:
    """Speed of the front of a long impact divided by that of the solitary wave of its peak force, ten beads on."""
    motion = _long_impact(run)
    particles, wave = strikes.particles_of(motion.case), solve_travelling_wave()
    solitary = wave.speed_by_force * particles.stiffness ** (1 / 3) * particles.mass_kg**-0.5
    speed, peak_N = _front(motion, 35)
    return float(speed / (solitary * peak_N ** (1 / 6)))


def leading_speed_weak(run: Run) -> float:
    """Speed of the front of a long weak impact above that of sound, divided by that of the KdV soliton of its height.

    340 beads below a striker of 1 kg and 0.1 m/s on a chain under 2 N. The soliton has ``V = c_0 [1 + (xi_m - xi_0) /
    (12 xi_0)]``.
    """
    chain = ("chain.count=400", "chain.precompression=2 N", "striker.speed=0.1 m/s", "run.duration=9.5 ms")
    motion = heavy_strike(run, "striker.mass=1 kg", *chain, "run.time_step=1 us", "run.sample_interval=5 us")
    static_N, particles = motion.case.scene.chain.precompression, strikes.particles_of(motion.case)
    speed, peak_N = _front(motion, 65)
    strain_above = particles.strain(peak_N) / particles.strain(static_N) - 1
    sound = sound_speed(particles, static_N) / particles.diameter_m
    return float((speed / sound - 1) / (strain_above / 12))


def _front(motion: Simulation, contact: int) -> tuple[float, float]:
    """Speed of the first wave over the ten beads below a contact, beads per second, and its mean peak force, N."""
    above, below = (waves(motion, place)[0] for place in (contact, contact - 10))
    return 10 / (below.time_s - above.time_s), (above.value * below.value) ** 0.5


def static_at_wall(_: Run, scene: str) -> float:
    """Static force on the wall divided by the weight of a scene's beads."""
    case = case_of(scene)
    weight = float(case.chain.mass_kg[: case.chain.beads].sum()) * case.scene.gravity
    return float(case.chain.force_N[0]) / weight


def exponents(run: Run, maxima: float) -> float:
    """Rate of the envelope at the wall in Fig. 5 with dissipation divided by that of the elastic chain of 1.46 GPa."""
    return envelope_rate(run, maxima, FITTED) / envelope_rate(run, maxima)


def attenuation(run: Run) -> float:
    """First maximum at the wall in Fig. 5 with dissipation divided by that of the elastic chain of 1.46 GPa."""
    return _kept(run, "fig5", without=ELASTIC)


def _kept(run: Run, scene: str, *settings: str, contact: int = 1, wave: int = 0, without: str = SOFTENED) -> float:
    """Maximum of a wave at a contact with dissipation divided by that without."""
    damped, elastic = (waves(run(of_law(scene, law, *settings)), contact) for law in (FITTED, without))
    return damped[wave].value / elastic[wave].value


def attenuation_by_amplitude(run: Run, waves_are: str) -> float:
    """Attenuation of a low wave divided by that of a high one, each the force with dissipation divided by that without.

    The third and the first maximum of Fig. 5's train at the wall, or single waves of 0.06 and 5 N without gravity.
    """
    if waves_are == "a train":
        return _kept(run, "fig5", wave=2) / _kept(run, "fig5")
    chain = (*UNCOMPRESSED, LONG_DURATION)
    low, high = (_kept(run, "table1", *chain, strike_of(force), contact=5) for force in (0.06, 5.0))
    return low / high


def valley(run: Run, scene: str) -> float:
    """Valley between the first two waves at the wall divided by the second, with dissipation."""
    return _valley(run(of_law(scene, FITTED)), 1)


def tail(run: Run, scene: str) -> float:
    """Least force behind the second wave at the wall divided by the first wave, with dissipation.

    It is read from one to two intervals of the first two maxima after the second.
    """
    motion = run(of_law(scene, FITTED))
    first, second = waves(motion, 1, at_least=2)[:2]
    after = (motion.trace.time_s - second.time_s) / (second.time_s - first.time_s)
    return float(motion.trace.force_N[(after > 1) & (after < 2), 0].min() / first.value)


def loss_on_small_beads(run: Run, per: str) -> float:
    """Loss of the first wave by dissipation in Fig. 6(a) divided by that in Fig. 5(a), of the chain or per bead."""
    kept, beads = zip(*((_kept(run, scene), case_of(scene).chain.beads) for scene in ("fig6b", "fig5")), strict=True)
    small, large = -np.log(kept) / beads if per == "bead" else np.subtract(1, kept)
    return float(small / large)
