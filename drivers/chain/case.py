"""A case: one scene made ready for any engine, and rules that only the built chain can be judged by."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import sqrt
from typing import Any

import numpy as np

from drivers.base.errors import InputProblem, refuse_any
from drivers.chain.chain import Array, Chain, build_chain, moving_at_start
from drivers.chain.elements import Element, choose_elements
from drivers.scene.model import RIGID, Scene

MAX_OVERLAP = 0.5  # of the radius, at rest: far beyond Hertz, and close to where engines lose a contact


@dataclass(frozen=True)
class SensorBead:
    """A bead that carries a gauge, counted from the wall; its height is that at time 0."""

    from_wall: int
    height_m: float
    diameter_m: float


@dataclass(frozen=True)
class Layout:
    """Which contacts there are and where the sensors sit.

    Attributes:
        sensors: from the top bead towards the wall: the order in which a wave meets them.
        load_N: sum of all weights and of the precompression, upwards positive.
        moving_N_s: momenta of all bodies at time 0 without their directions.
        damped: whether contacts lose energy in impacts.
        slips: whether they have friction.
        time_constant_s: of the electronics behind the gauges; None: they show the force itself.
    """

    sensors: tuple[SensorBead, ...]
    wall: bool
    striker: bool
    load_N: float
    moving_N_s: float = 0.0
    damped: bool = False
    slips: bool = False
    time_constant_s: float | None = None


def read_layout(stored: dict[str, Any]) -> Layout:
    """A layout as a run record holds it; older records know of no electronics."""
    sensors = tuple(SensorBead(**sensor) for sensor in stored["sensors"])
    return Layout(**(stored | {"sensors": sensors}))


@dataclass(frozen=True)
class Plan:
    """What was asked for and what is predicted, by quantity; errors as in ``validation.accuracy.schemes``.

    Attributes:
        predicted: the error of the codes' scheme at the chosen step, measured with it on this very case.
        rounding_share: what rounding of absolute heights may add on engines that hold them, of the largest change.
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


@dataclass(frozen=True, eq=False)
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
    def work(self) -> int:
        """Bodies times steps: what a run's cost goes with."""
        return self.chain.bodies * self.scene.steps

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
        scene, chain = self.scene, self.chain
        places = sorted((sensor.from_wall for sensor in scene.chain.sensors), reverse=True)
        heights, radii = chain.height_m, chain.radius_m
        return Layout(
            sensors=tuple(SensorBead(j, float(heights[j - 1]), float(2 * radii[j - 1])) for j in places),
            wall=chain.wall is not None,
            striker=scene.striker is not None,
            load_N=float(chain.load_N.sum()),
            moving_N_s=moving_at_start(chain),
            damped=chain.damped,
            slips=chain.slips,
            time_constant_s=scene.sensor.time_constant if scene.sensor else None,
        )

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
        if chain.damped:
            words += f"; {chain.dissipation}"
        return words


def build_case(scene: Scene) -> Case:
    """The case of a scene; where it asks for an accuracy, the time step is still to be planned.

    Raises:
        InputError: its masses or loads make no chain.
    """
    chain = build_chain(scene)
    refuse_any(scene.file, _impossible(scene, chain))
    if scene.three_dimensional:
        from drivers.chain.lateral_start import with_lateral  # scipy: only where it is needed

        chain = with_lateral(scene, chain)
    return Case(scene, chain, choose_elements(scene, chain))


def _impossible(scene: Scene, chain: Chain) -> Iterator[InputProblem]:
    """What shows only in the chain as built: masses below zero, beads that overlap or pass each other."""
    if (chain.mass_kg <= 0).any():
        place = int(np.argmin(chain.mass_kg)) + 1
        yield "chain.mass_scatter", f"{scene.chain.mass_scatter:g} kg, which leaves bead {place} no mass", "less"
    deepest = chain.overlap_m / chain.smaller_radius_m
    if (deepest > MAX_OVERLAP).any():
        contact = int(np.argmax(deepest)) + 1
        key = "chain.precompression" if chain.precompression_N else "gravity"
        found = f"a load that presses {chain.overlap_m[contact - 1]:g} m deep at contact {contact}"
        yield key, found, f"overlaps of at most {MAX_OVERLAP:g} of the radius"
    tube = scene.tube
    if not scene.three_dimensional or tube is None:
        return
    yield from _passing(tube.inner_diameter / 2, chain)
    height, radius = chain.height_m, chain.radius_m
    if tube.top is not None and height[chain.beads - 1] > tube.top:
        yield "tube.top", f"{tube.top:g} m", f"at least {height[chain.beads - 1]:.4g} m, the height of the top bead"
    if scene.striker is not None and radius[-1] >= tube.inner_diameter / 2:
        # where the striker's surface stands above the rim of the bore
        sphere = np.isfinite(radius[-1])
        rim = height[-1] - (sqrt(radius[-1] ** 2 - tube.inner_diameter**2 / 4) if sphere else 0.0)
        if tube.top is None or tube.top > rim:
            found = "nothing" if tube.top is None else f"{tube.top:g} m"
            yield "tube.top", found, f"at most {rim:.4g} m: the striker is wider than the bore and stays above it"


def _passing(bore_radius_m: float, chain: Chain) -> Iterator[InputProblem]:
    """Beads so loose that they would touch the next but one."""
    radius = chain.radius_m[chain.radius_m < bore_radius_m]
    play = bore_radius_m - radius
    reach, across = radius[1:] + radius[:-1], play[1:] + play[:-1]
    apart = np.sqrt(np.maximum(reach**2 - across**2, 0.0))
    if (apart[1:] + apart[:-1] <= radius[2:] + radius[:-2]).any() or (across >= reach).any():
        allowed = "a tube so narrow that beads stay in line, each between its neighbours"
        yield "tube.inner_diameter", f"{2 * bore_radius_m:g} m", allowed
