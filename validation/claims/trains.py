"""Claims on trains of waves: Fig. 5's striker, the pulse that enters and its envelope, Fig. 6, static forces."""

from drivers.base.errors import InputError
from postproc.paper import theory
from postproc.paper.simulate import Simulation, case_of
from postproc.paper.strikes import speed_between_sensors
from postproc.read.observables import observe
from postproc.read.sensors import sensor_average
from postproc.read.signals import ONSET, Peak, incident_pulse, peaks
from validation.claims.chains import MICRO, Run, heavy_strike, rate_through, waves
from validation.reference.travelling_wave import solve_travelling_wave


def _significant(train: list[Peak], share: float) -> float:
    """Number of waves above a share of the first, before a larger one follows (the reflected wave)."""
    rising = next((i for i in range(1, len(train)) if train[i].value > train[i - 1].value), len(train))
    return float(sum(peak.value > share * train[0].value for peak in train[:rising]))


def train_count(run: Run, share: float) -> float:
    """Waves above a share of the first, thirty beads below Fig. 5's striker, no gravity."""
    return _significant(waves(heavy_strike(run), 31), share)


def small_waves(run: Run, share: float) -> float:
    """Waves above a share of the first divided by those above 5 %, thirty beads below Fig. 5's striker, no gravity."""
    train = waves(heavy_strike(run, "chain.count=100", "run.duration=6 ms", "run.time_step=1 us"), 71, prominence=1e-3)
    return _significant(train, share) / _significant(train, 0.05)


def splitting(run: Run, below: float) -> float:
    """Valley between the first two waves divided by the second, some beads below Fig. 5's striker, no gravity."""
    motion, contact = heavy_strike(run), 61 - round(below)
    first, second = waves(motion, contact, at_least=2)[:2]
    return float(motion.trace.force_N[first.sample : second.sample, contact - 1].min() / second.value)


def count_at_wall(run: Run, scene: str, share: float) -> float:
    """Waves that reach the wall, above a share of the first, before the reflected one."""
    return _significant(waves(run(case_of(scene)), 1), share)


def _piston(run: Run) -> tuple[Simulation, Simulation]:
    """Runs of Fig. 5's striker on a chain without and with a static force of 0.5 N."""
    gauges = "chain.sensors=[{ from_wall = 50 }, { from_wall = 45 }]"
    return heavy_strike(run, gauges), heavy_strike(run, gauges, "chain.precompression=0.5 N")


def precompression_speed(run: Run) -> float:
    """Speed of the leading wave under 0.5 N divided by that without, ten to fifteen beads below the striker."""
    bare, pressed = _piston(run)
    return speed_between_sensors(pressed) / speed_between_sensors(bare)


def precompression_splitting(run: Run) -> float:
    """Depth of the valley after the first wave divided by its height, under 0.5 N divided by that without."""
    depths = []
    for motion in _piston(run):
        reading = sensor_average(motion.trace.force_N, 45)
        dynamic = reading - reading[0]
        first, second = peaks(motion.trace.time_s, dynamic, prominence=1e-3)[:2]
        depths.append(1 - dynamic[first.sample : second.sample].min() / first.value)
    return float(depths[1] / depths[0])


def precompression_width(run: Run) -> float:
    """Width of the leading wave at half its peak in diameters, under 0.5 N divided by that without."""
    bare, pressed = (observe(motion.case.layout, motion.trace, (0.5,)) for motion in _piston(run))
    return pressed["bead_45_width_50pct_diameters"] / bare["bead_45_width_50pct_diameters"]


def envelope_rate(run: Run, maxima: float) -> float:
    """Rate of the exponential through the first maxima at the wall in Fig. 5, per microsecond."""
    return rate_through(waves(run(case_of("fig5")), 1), maxima)


def envelope_by_place(run: Run, bead: float) -> float:
    """Rate through the first two maxima in a bead of Fig. 5 divided by that at the wall."""
    motion = run(case_of("fig5"))
    reading = sensor_average(motion.trace.force_N, round(bead))
    maxima = peaks(motion.trace.time_s, reading - reading[0])
    return rate_through(maxima, 2) / envelope_rate(run, 2)


def entrance(run: Run, number: str, times: float, bead: float, onset: float = ONSET) -> float:
    """A number of the incident pulse, from the averaged force in a bead of Fig. 5, in SI units times a factor."""
    motion = run(case_of("fig5"))
    reading = sensor_average(motion.trace.force_N, round(bead))
    shape = incident_pulse(motion.trace.time_s, reading - reading[0], onset)
    if shape is None:
        raise InputError(motion.case.scene.file, "run.duration", "a run without the reflected wave", "a longer run")
    return float(getattr(shape, number) * times)  # NaN for the duration of a pulse that does not end


def decay_ratio(run: Run, bead: float, maxima: float) -> float:
    """Rate of decay of the pulse that enters at a bead divided by that of the envelope at the wall."""
    return entrance(run, "decay_per_s", 1 / MICRO, bead) / envelope_rate(run, maxima)


def _long_impact(run: Run) -> Simulation:
    """Sixty beads under a striker of 1 kg, 8000 of their masses, no gravity."""
    return heavy_strike(run, "striker.mass=1 kg")


def oscillations(run: Run) -> float:
    """Maxima behind the front of a long impact, thirty beads below the striker, 2.4 ms after it."""
    return float(len(waves(_long_impact(run), 30)))


def leading_speed(run: Run) -> float:
    """Speed of the front of a long impact divided by that of the solitary wave of its peak force, ten beads on."""
    motion = _long_impact(run)
    particles, wave = theory.particles_of(motion.case), solve_travelling_wave()
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
    static_N, particles = float(motion.case.chain.precompression_N), theory.particles_of(motion.case)
    speed, peak_N = _front(motion, 65)
    strain_above = particles.strain(peak_N) / particles.strain(static_N) - 1
    sound = theory.sound_speed(particles, static_N) / particles.diameter_m
    return float((speed / sound - 1) / (strain_above / 12))


def _front(motion: Simulation, contact: int) -> tuple[float, float]:
    """Speed of the first wave over the ten beads below a contact, beads per second, and its mean peak force, N."""
    above, below = (waves(motion, place)[0] for place in (contact, contact - 10))
    return 10 / (below.time_s - above.time_s), (above.value * below.value) ** 0.5


def static_at_wall(scene: str) -> float:
    """Static force on the wall divided by the weight of a scene's beads."""
    case = case_of(scene)
    weight = float(case.chain.mass_kg[: case.chain.beads].sum()) * case.scene.gravity
    return float(case.chain.force_N[0]) / weight
