"""Claims on dissipation in the experiments: chains with the calibrated law, compared with elastic chains."""

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from postproc.paper.calibrated import calibrated
from postproc.paper.simulate import case_of
from postproc.read.signals import Peak
from validation.claims.chains import LONG_DURATION, UNCOMPRESSED, Run, rate_through, ratio_of, strike_of, waves

SEEN_LATER = "run.duration=1.4 ms"  # until the reflected wave has passed softer beads
TAIL_S = (60e-6, 160e-6)  # after the second wave's maximum


def fig4(run: Run, observable: str, over: str = "") -> float:
    """An observable of Fig. 4's chain with dissipation, or its ratio to another."""
    return ratio_of(run(_calibrated("fig4", SEEN_LATER)).values, observable, over)


def envelope_rate(run: Run, maxima: float) -> float:
    """Rate of the exponential through the first maxima at the wall in Fig. 5 with dissipation, per microsecond."""
    return rate_through(waves(run(_calibrated("fig5")), 1), maxima)


def attenuation(run: Run) -> float:
    """First maximum at the wall in Fig. 5 with dissipation divided by that of the elastic chain of 1.46 GPa."""
    damped, elastic = (waves(run(case), 1) for case in (_calibrated("fig5"), case_of("fig5")))
    return damped[0].value / elastic[0].value


def exponents(run: Run, maxima: float) -> float:
    """Rate of the envelope at the wall in Fig. 5 with dissipation divided by that of the elastic chain of 1.46 GPa."""
    return envelope_rate(run, maxima) / rate_through(waves(run(case_of("fig5")), 1), maxima)


def attenuation_by_amplitude(run: Run, waves_are: str) -> float:
    """Attenuation of a low wave divided by that of a high one, each the force with dissipation divided by that without.

    The third and the first maximum of Fig. 5's train at the wall, or single waves of 0.06 and 5 N without gravity.
    """
    if waves_are == "a train":
        damped, elastic = (waves(run(case), 1) for case in (_calibrated("fig5"), _softened("fig5")))
        low, high = (damped[i].value / elastic[i].value for i in (2, 0))
    else:
        low, high = (_kept(run, "table1", 5, *UNCOMPRESSED, LONG_DURATION, strike_of(force)) for force in (0.06, 5.0))
    return low / high


def _kept(run: Run, scene: str, contact: int = 1, *settings: str) -> float:
    """First maximum at a contact with dissipation divided by that without."""
    damped, elastic = (waves(run(case(scene, *settings)), contact) for case in (_calibrated, _softened))
    return damped[0].value / elastic[0].value


def valley(run: Run, scene: str) -> float:
    """Valley between the first two waves at the wall divided by the second, with dissipation."""
    force, first, second = _first_two(run, scene)
    return float(force[first.sample : second.sample].min() / second.value)


def tail(run: Run, scene: str) -> float:
    """Least force at the wall from 60 to 160 µs after the second wave divided by the first wave, with dissipation."""
    force, first, second = _first_two(run, scene)
    after = run(_calibrated(scene)).trace.time_s - second.time_s
    return float(force[(after > TAIL_S[0]) & (after < TAIL_S[1])].min() / first.value)


def _first_two(run: Run, scene: str) -> tuple[Array, Peak, Peak]:
    """Force at the wall, and the first two waves in it, with dissipation."""
    motion = run(_calibrated(scene))
    first, second = waves(motion, 1, at_least=2)[:2]
    return motion.trace.force_N[:, 0], first, second


def loss_on_small_beads(run: Run, per: str) -> float:
    """Loss of the first wave by dissipation in Fig. 6(a) divided by that in Fig. 5(a), of the chain or per bead."""
    losses = []
    for scene in ("fig6b", "fig5"):
        kept, beads = _kept(run, scene), case_of(scene).chain.beads
        losses.append(-np.log(kept) / beads if per == "bead" else 1 - kept)
    return float(losses[0] / losses[1])


def _calibrated(scene: str, *settings: str) -> Case:
    return case_of(scene, *calibrated().settings, *settings)


def _softened(scene: str, *settings: str) -> Case:
    """Calibrated chain without dissipation."""
    return _calibrated(scene, *settings, "contact.restitution=")
