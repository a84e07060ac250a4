"""A case: one scene made ready for any engine."""

from dataclasses import dataclass, replace

import numpy as np

from drivers.base.errors import refuse_any
from drivers.chain.chain import Array, Chain, build_chain
from drivers.chain.chain_rules import impossible
from drivers.chain.contact_law import restitution
from drivers.chain.elements import Element, choose_elements
from drivers.chain.layout import Layout, make_layout
from drivers.scene.model import RIGID, Scene


@dataclass(frozen=True)
class Plan:
    """What was asked for and what is predicted, by quantity; errors as in ``validation.accuracy.schemes``.

    Attributes:
        predicted: the error of the codes' scheme at the chosen step, measured with it on this very case.
        rounding_share: what rounding of absolute heights may add on engines that hold them, of the largest force.
        refused_steps: the largest step found too coarse, in steps a sample; 0 where none was.
        trials: runs of the in-repo scheme that it took.
        seconds: what the plan cost.
    """

    asked: dict[str, float]
    predicted: dict[str, float]
    rounding_share: float
    refused_steps: int
    trials: int
    seconds: float = 0.0


@dataclass(frozen=True)
class Case:
    """What every engine's deck is rendered from, and what its raw output is read with.

    Attributes:
        plan: how the time step was chosen, where the scene asks for an accuracy (``validation.accuracy.plan``).
        full: the case with all that the scene has, where that accuracy lets some of it be left out.
    """

    scene: Scene
    chain: Chain
    elements: tuple[Element, ...]
    plan: Plan | None = None
    full: "Case | None" = None

    def at(self, steps_per_sample: int) -> "Case":
        """The same case at another time step."""
        step = self.scene.run.sample_interval / steps_per_sample
        run = self.scene.run.model_copy(update={"time_step": step})
        return replace(self, scene=self.scene.model_copy(update={"run": run, "steps_per_sample": steps_per_sample}))

    def sampled_at_every(self, time_step_s: float) -> "Case":
        """The same case with any time step, and a sample at each; it ends within a step of where it ended."""
        samples = max(2, int(float(self.sample_times_s[-1]) / time_step_s * (1 + 1e-12)) + 1)
        run = self.scene.run.model_copy(update={"sample_interval": time_step_s, "time_step": time_step_s})
        changes = {"run": run, "steps_per_sample": 1, "samples": samples}
        return replace(self, scene=self.scene.model_copy(update=changes), plan=None)

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
        if chain.damping_ratio:
            words += f"; impacts have a restitution of {restitution(chain.damping_ratio):.6g}"
        return words


def build_case(scene: Scene) -> Case:
    """The case of a scene; where it asks for an accuracy, the time step is still to be planned.

    Raises:
        InputError: its masses or loads make no chain.
    """
    chain = build_chain(scene)
    refuse_any(scene.file, impossible(scene, chain))
    if scene.three_dimensional:
        from drivers.chain.lateral_start import with_lateral  # scipy: only where it is needed

        chain = with_lateral(scene, chain)
    return Case(scene, chain, choose_elements(scene, chain))
