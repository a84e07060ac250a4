"""Traces of chains with one fault, by the integrators of ``validation.reference`` without an engine."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array, arrays_of
from drivers.chain.schemes import heights_and_reach, trace_of
from drivers.chain.trace import Trace
from validation.reference.hertz_chain import HertzChain
from validation.reference.velocity_verlet import integrate_verlet, integrate_verlet_absolute

Changed = tuple[HertzChain, str]  # chain, expected kind of the diagnosis
Sabotage = Callable[[Case, np.random.Generator], Changed | None]


def trace_with(case: Case, chain: HertzChain, *, in_heights: bool = True) -> Trace:
    """Trace that an engine would have recorded of a changed chain; energies are from the masses of the scene."""
    scene = case.scene
    timing = (scene.time_step_s, scene.steps_per_sample, scene.samples)
    motion = integrate_verlet(chain, *timing)
    if in_heights:
        height, reach = heights_and_reach(case)
        lowered = np.cumsum(chain.overlap_m - case.chain.overlap_m)
        force = integrate_verlet_absolute(chain, height - lowered, reach, *timing).force_N
        motion = replace(motion, force_N=force)
    return trace_of(case, case.sample_times_s, motion)


def _factor(draw: np.random.Generator) -> float:
    """A factor from 0.5 to 2, not within 1 % of 1."""
    return float(np.exp(draw.choice([-1, 1]) * draw.uniform(0.01, np.log(2))))


def _times(array: Array, places: slice | int, factor: float) -> Array:
    changed = array.copy()
    changed[places] *= factor
    return changed


def _weighing(case: Case, chain: HertzChain, mass: Array) -> HertzChain:
    load = chain.load_N - case.chain.gravity_m_s2 * (mass - chain.mass_kg)
    return replace(chain, mass_kg=mass, load_N=load)


def softer_wall(case: Case, draw: np.random.Generator) -> Changed | None:
    if case.chain.wall is None:
        return None
    chain = arrays_of(case.chain)
    return replace(chain, stiffness=_times(chain.stiffness, 0, _factor(draw))), "wall contact"


def stiffer_beads(case: Case, draw: np.random.Generator) -> Changed:
    chain, beads = arrays_of(case.chain), slice(1, case.chain.beads)
    return replace(chain, stiffness=_times(chain.stiffness, beads, _factor(draw))), "bead contacts"


def stiffer_striker(case: Case, draw: np.random.Generator) -> Changed:
    chain = arrays_of(case.chain)
    return replace(chain, stiffness=_times(chain.stiffness, -1, _factor(draw))), "striker contact"


def one_contact(case: Case, draw: np.random.Generator) -> Changed | None:
    chain = arrays_of(case.chain)
    if case.chain.beads < 3:
        return None  # the same as the contacts of all beads
    j = int(draw.integers(1, case.chain.beads))
    return replace(chain, stiffness=_times(chain.stiffness, j, _factor(draw))), f"contact {j + 1}"


def heavier_striker(case: Case, draw: np.random.Generator) -> Changed:
    chain = arrays_of(case.chain)
    return _weighing(case, chain, _times(chain.mass_kg, -1, _factor(draw))), "striker mass"


def one_bead(case: Case, draw: np.random.Generator) -> Changed:
    chain, j = arrays_of(case.chain), int(draw.integers(0, case.chain.beads))
    return _weighing(case, chain, _times(chain.mass_kg, j, _factor(draw))), f"mass of bead {j + 1}"


def all_beads(case: Case, draw: np.random.Generator) -> Changed:
    chain, beads = arrays_of(case.chain), slice(0, case.chain.beads)
    return _weighing(case, chain, _times(chain.mass_kg, beads, _factor(draw))), "bead masses"


def slower_striker(case: Case, draw: np.random.Generator) -> Changed:
    chain = arrays_of(case.chain)
    return replace(chain, velocity_m_s=_times(chain.velocity_m_s, -1, _factor(draw))), "striker speed"


def no_speed(case: Case, draw: np.random.Generator) -> Changed:
    chain = arrays_of(case.chain)
    return replace(chain, velocity_m_s=0 * chain.velocity_m_s), "striker speed"


def no_gravity(case: Case, draw: np.random.Generator) -> Changed | None:
    chain, weight = arrays_of(case.chain), case.chain.gravity_m_s2 * case.chain.mass_kg
    return (replace(chain, load_N=chain.load_N + weight), "gravity") if weight.any() else None


def no_precompression(case: Case, draw: np.random.Generator) -> Changed | None:
    chain = arrays_of(case.chain)
    load = chain.load_N.copy()
    load[case.chain.beads - 1] += case.chain.precompression_N
    return (replace(chain, load_N=load), "precompression") if case.chain.precompression_N else None


def damped(case: Case, draw: np.random.Generator) -> Changed:
    other = replace(case.chain, damping_ratio=float(draw.uniform(0.003, 0.3)))
    return replace(arrays_of(case.chain), damping=other.damping), "damping"


def just_touching(case: Case, draw: np.random.Generator) -> Changed | None:
    chain = arrays_of(case.chain)
    return (replace(chain, overlap_m=0 * chain.overlap_m), "placing") if chain.overlap_m.any() else None


SABOTAGES: tuple[Sabotage, ...] = (
    softer_wall, stiffer_beads, stiffer_striker, one_contact, heavier_striker, one_bead, all_beads, slower_striker,
    no_speed, no_gravity, no_precompression, damped, just_touching,
)  # fmt: skip
