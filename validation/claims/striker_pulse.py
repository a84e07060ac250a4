"""Claims on Fig. 5: the pulse that enters the chain, and the envelope of what reaches the wall."""

from drivers.base.errors import InputError
from postproc.paper.simulate import case_of
from postproc.read.pulse import ENVELOPE_MAXIMA, PulseShape, envelope, incident_pulse
from postproc.read.sensors import sensor_average
from validation.claims.simulated import Run, waves

MICRO = 1e6


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


COMPUTED = {
    "fig5-envelope": envelope_rate,
    "fig5-envelope-measured": envelope_rate,
    "fig5-rise": rise,
    "fig5-decay": decay,
    "fig5-duration": duration,
    "fig5-decay-ratio": decay_ratio,
}
