"""A case: one scene made ready for any engine."""

from dataclasses import dataclass

import numpy as np

from drivers.chain import Array, Chain, build_chain
from drivers.elements import Element, choose_elements
from drivers.errors import InputError
from drivers.layout import Layout, make_layout
from drivers.scene import RIGID, Scene
from drivers.scene_rules import impossible


@dataclass(frozen=True)
class Case:
    """What every engine's deck is rendered from, and what its raw output is read with."""

    scene: Scene
    chain: Chain
    elements: tuple[Element, ...]

    @property
    def sample_times_s(self) -> Array:
        """Times of the samples as multiples of the time step. Shape (samples,)."""
        return np.arange(self.scene.samples, dtype=float) * (self.scene.steps_per_sample * self.scene.time_step_s)

    @property
    def sample_steps(self) -> range:
        """Time steps at which samples are taken."""
        every = self.scene.steps_per_sample
        return range(0, self.scene.steps + 1, every)

    def models(self, element: str) -> bool:
        """Whether the deck models an element, by its name."""
        return next(each.modelled for each in self.elements if each.name == element)

    @property
    def layout(self) -> Layout:
        """What post-processing needs to know of the chain."""
        return make_layout(self.scene, self.chain)

    @property
    def summary(self) -> str:
        """The case in words, for a deck's head: free of names, since equal decks are one run."""
        chain, striker = self.chain, self.scene.striker
        beads = f"{chain.beads} bead{'s' if chain.beads != 1 else ''}"
        wall = "a rigid wall" if chain.wall == RIGID else f"a wall of {chain.wall}"
        words = f"{beads} on {wall}" if chain.wall else f"{beads} in a free chain"
        if striker is not None:
            shape = "flat face" if striker.shape == "flat" else "sphere"
            words += f", struck by a {shape} of {striker.material} at {striker.speed:g} m/s"
        return words


def build_case(scene: Scene) -> Case:
    """The case of a scene.

    Raises:
        InputError: its masses or loads make no chain.
    """
    chain = build_chain(scene)
    for complaint in impossible(scene, chain):
        raise InputError(scene.file, *complaint)
    return Case(scene, chain, choose_elements(scene, chain))
