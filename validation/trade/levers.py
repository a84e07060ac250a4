"""Levers of the trade study: other ways to save time or error, each with its effect."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import nan

from drivers.chain.schemes import exact_of, verlet_of
from drivers.limits.criteria import rayleigh_time
from postproc.paper.simulate import case_of
from postproc.read.observables import of_kind
from validation.accuracy.exact_motion import errors_of, exact_motion_of, quantities

SOFTENING_FACTORS = (10, 100, 1000)
FRACTIONS = (0.1, 0.2, 0.4)


@dataclass(frozen=True)
class Lever:
    """One measurement of a lever.

    Attributes:
        error: error of the quantity, as in ``accuracy.exact_motion``.
        gain: cost without the lever divided by cost with it; NaN if the lever changes only the error.
    """

    lever: str
    scene: str
    setting: str
    quantity: str
    error: float
    gain: float = nan


def measure_levers() -> Iterator[Lever]:
    """Measures all levers."""
    yield from sampling()
    yield from rayleigh()
    yield from softened()


def sampling() -> Iterator[Lever]:
    """Errors of peaks and arrivals of the exact motion when read from samples at several intervals."""
    fine = exact_motion_of(case_of("fig4"))
    for interval in ("0.5 us", "1 us", "2 us", "5 us", "10 us"):
        case = case_of("fig4", f"run.sample_interval={interval}", "run.time_step=0.1 us")
        seen = quantities(case, exact_of(case, 1e-12))
        for name in ("bead_5_peak", "wall_peak", "wall_arrival", "speed_9_to_5"):
            error = abs(seen[name] / fine.true[name] - 1)
            yield Lever("sampling interval", "fig4", interval.replace("u", "µ"), name, error)


def rayleigh() -> Iterator[Lever]:
    """Errors at fractions of the Rayleigh time."""
    for scene in ("fig4", "fig5", "fig6b", "fig6d", "low-amplitude", "steel-chain"):
        base = case_of(scene)
        for fraction in FRACTIONS:
            step = fraction * rayleigh_time(base)
            case = base.sampled_at_every(step)
            exact_motion = exact_motion_of(case)
            true = exact_motion.true
            names = ["force", *(name for name in of_kind(true, "peak", "speed") if not name.startswith("bead"))]
            for name, error in errors_of(case, verlet_of(case), exact_motion, names).items():
                yield Lever("share of the Rayleigh time", scene, f"{fraction:g}", name, error)


def softened() -> Iterator[Lever]:
    """Errors of V_s and F_m on softened beads, scaled back by E^(2/5); the gain is that of the larger time step.

    Without gravity, with a rigid wall and one material, the chain is similar: at a given striker speed times are
    proportional to E^(-2/5), forces to E^(2/5).
    """
    for gravity in ("", "9.81 m/s^2"):
        base = ("wall.material=rigid", f"gravity={gravity}")
        hard = quantities(case := case_of("fig4", *base), exact_of(case, 1e-11))
        for softer in SOFTENING_FACTORS:
            longer = softer**0.4
            case = case_of(
                "fig4", *base, f"materials.ptfe.youngs_modulus={1.46e9 / softer} Pa",
                f"run.duration={0.8 * longer} ms", f"run.sample_interval={longer} us",
                f"run.time_step={longer / 10} us",
            )  # fmt: skip
            soft = quantities(case, exact_of(case, 1e-11))
            where = "with gravity" if gravity else "without gravity"
            for name in ("speed_9_to_5", "bead_5_amplitude", "wall_amplitude"):
                error = abs(soft[name] * longer / hard[name] - 1)
                yield Lever("softened modulus", "fig4", f"E/{softer}, {where}", name, error, longer)
