"""Claims on trains of waves, on Fig. 5's pulse, on waves that meet, and on strikes under a static force."""

from drivers.base.errors import InputError
from postproc.paper.simulate import Simulation, case_of
from postproc.paper.strikes import speed_between_sensors
from postproc.read.observables import observe
from postproc.read.pulse import ENVELOPE_MAXIMA, PulseShape, envelope, incident_pulse
from postproc.read.sensors import sensor_average
from postproc.read.signals import peaks
from validation.claims.simulated import BARE, Run, signal, significant, waves

MICRO = 1e6


def single_wave(run: Run) -> float:
    """Largest force after the first wave over that wave's, thirty beads below a striker like the beads, no gravity."""
    one = run(case_of("table1", *BARE, "chain.count=60", "run.duration=4 ms"))
    first = waves(one, 30)[0]
    force = signal(one, 30)[1][first.sample :]
    passed = int((force < 1e-3 * first.value).argmax())  # the first wave's own tail does not count
    return float(force[passed:].max() / first.value)


def collision(run: Run) -> float:
    """Secondary wave over the original ones after two equal waves met at a contact, no gravity."""
    ends = "chain.bead=[{ from_wall = 1, velocity = '1 m/s' }, { from_wall = 80, velocity = '-1 m/s' }]"
    one = run(case_of("table1", *BARE, "striker=", "chain.count=80", "chain.sensors=[]", ends, "run.duration=2.6 ms"))
    found = waves(one, 61, at_least=3, prominence=1e-3)  # from above, from below, and what follows
    return found[2].value / found[0].value


def _heavy_strike(run: Run, *settings: str) -> Simulation:
    """Fig. 5's striker on sixty beads without gravity."""
    return run(case_of("fig5", "gravity=", "chain.count=60", "run.duration=2.4 ms", *settings))


def train_count(run: Run) -> float:
    """Waves above 5 % of the first, thirty beads below Fig. 5's striker, no gravity."""
    return significant(waves(_heavy_strike(run), 31))


def splitting(run: Run) -> float:
    """Valley between the first two waves over the second, ten beads below Fig. 5's striker, no gravity."""
    one = _heavy_strike(run)
    first, second = waves(one, 51, at_least=2)[:2]
    return float(signal(one, 51)[1][first.sample : second.sample].min() / second.value)


def fig5_count(run: Run) -> float:
    """Waves that reach the wall in Fig. 5, above 5 % of the first, before the reflected one."""
    return significant(waves(run(case_of("fig5")), 1))


def fig6d_count(run: Run) -> float:
    """Waves that reach the wall in Fig. 6d, above 5 % of the first, before the reflected one."""
    return significant(waves(run(case_of("fig6d")), 1))


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
    maxima = waves(run(case_of("fig5")), 1, at_least=ENVELOPE_MAXIMA)[:ENVELOPE_MAXIMA]
    return envelope(maxima).rate_per_s / MICRO


def _entrance(run: Run) -> PulseShape:
    """The averaged force at the top bead of Fig. 5."""
    one = run(case_of("fig5"))
    reading = sensor_average(one.trace.force_N, one.case.chain.beads)
    shape = incident_pulse(one.trace.time_s, reading - reading[0])
    if shape is None:
        raise InputError(one.case.scene.file, "run.duration", "no reflected wave within it", "until the wave is back")
    return shape


def rise(run: Run) -> float:
    """Rise of the averaged force at the top bead of Fig. 5, microseconds."""
    return _entrance(run).rise_s * MICRO


def decay(run: Run) -> float:
    """Rate of the initial decay of the averaged force at the top bead of Fig. 5, per microsecond."""
    return _entrance(run).decay_per_s / MICRO


def duration(run: Run) -> float:
    """Duration of the averaged force at the top bead of Fig. 5, microseconds."""
    return _entrance(run).duration_s * MICRO


def decay_ratio(run: Run) -> float:
    """Rate of decay of the incident pulse at the top bead over that of the envelope at the wall."""
    return decay(run) / envelope_rate(run)
