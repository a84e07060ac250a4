"""Softened beads: a larger time step at the price of an error, unless the chain is similar to the hard one."""

from collections.abc import Iterator
from dataclasses import dataclass

from drivers.chain.schemes import exact_of
from postproc.paper.simulate import case_of
from validation.accuracy.motions import quantities

FACTORS = (10, 100, 1000)  # by which the modulus is divided


@dataclass(frozen=True)
class Softened:
    """Error of a quantity of Fig. 4 with softened beads, scaled back to the hard ones.

    Attributes:
        setting: factor of the modulus, with or without gravity.
        error: relative error of the scaled quantity.
        gain: allowed time step divided by that of the hard beads.
    """

    setting: str
    quantity: str
    error: float
    gain: float


def soften() -> Iterator[Softened]:
    """Errors of V_s and F_m, scaled back by E^(2/5).

    Without gravity, with a rigid wall and one material, the chain is similar: at a given striker speed times are
    proportional to E^(-2/5), forces to E^(2/5).
    """
    for gravity in ("", "9.81 m/s^2"):
        base = ("wall.material=rigid", f"gravity={gravity}")
        hard = quantities(case := case_of("fig4", *base), exact_of(case, 1e-11))
        for softer in FACTORS:
            longer = softer**0.4
            case = case_of(
                "fig4", *base, f"materials.ptfe.youngs_modulus={1.46e9 / softer} Pa",
                f"run.duration={0.8 * longer} ms", f"run.sample_interval={longer} us",
                f"run.time_step={longer / 10} us",
            )  # fmt: skip
            soft = quantities(case, exact_of(case, 1e-11))
            where = "with gravity" if gravity else "without gravity"
            for name in ("speed_9_to_5", "bead_5_amplitude", "wall_amplitude"):
                yield Softened(f"E/{softer}, {where}", name, abs(soft[name] * longer / hard[name] - 1), longer)
