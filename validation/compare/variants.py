"""The table of variants: a case as a code may have got it, with at most one parameter."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import inf
from typing import Any

import numpy as np

from drivers.base import paths
from drivers.base.messages import validate
from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain
from drivers.chain.contact_law import hertz_stiffness, restitution_with_attraction
from drivers.chain.integrator_arrays import arrays_of
from drivers.engines import EXACT, Defaults, load_engine
from drivers.scene.model import RIGID, Material
from drivers.scene.read_scene import read_toml
from validation.accuracy.schemes import heights_and_reach
from validation.reference.adaptive import integrate_adaptive
from validation.reference.hertz_chain import Motion
from validation.reference.velocity_verlet import integrate_verlet_absolute

ADAPTIVE_TOLERANCE = 1e-11
FACTORS = np.logspace(-1.7, 1.7, 41)
RATIOS = np.logspace(-6, 0.5, 30)


@dataclass(frozen=True)
class Model:
    """A case as a code may have got it.

    Attributes:
        case: as it should be.
        chain: as it is; what its overlaps differ by from the case's moves bodies.
        exact: whether it is followed by the adaptive integrator instead of by steps.
        ahead: by how many time steps the start velocities are ahead of those of the chain.
        staggered: whether velocities of half a step before time 0 are set, by the case's step and accelerations.
        attraction, local_damping: as ``integrate_verlet_absolute`` has them.
    """

    case: Case
    chain: Chain
    time_step_s: float
    steps_per_sample: int
    exact: bool = False
    ahead: float = 0.0
    staggered: bool = False
    attraction: bool = False
    local_damping: float = 0.0

    def having(self, **changes: Any) -> "Model":
        """The model with other values of its own or other arrays of its chain; other masses have other weights."""
        own = {name: changes.pop(name) for name in list(changes) if name in self.__dataclass_fields__}
        if "mass_kg" in changes:
            heavier = changes["mass_kg"] - self.chain.mass_kg
            changes["load_N"] = self.chain.load_N - self.chain.gravity_m_s2 * heavier
        return replace(self, chain=replace(self.chain, **changes), **own)

    def scaled(self, name: str, places: Sequence[int], factor: float) -> "Model":
        """The model with some values of an array of its chain multiplied."""
        array = getattr(self.chain, name).copy()
        array[places] *= factor
        return self.having(**{name: array})

    def motion(self, samples: int, lift_m: float = 0.0) -> Motion:
        """The motion from time 0 on; all heights may be lifted, which changes their rounding alone."""
        arrays = replace(arrays_of(self.chain), velocity_m_s=self.start_velocity_m_s)
        if self.exact:
            times = np.arange(samples, dtype=float) * (self.time_step_s * self.steps_per_sample)
            return integrate_adaptive(arrays, times, ADAPTIVE_TOLERANCE)
        height, reach = heights_and_reach(self.case)
        lowered = np.cumsum(self.chain.overlap_m - self.case.chain.overlap_m)
        return integrate_verlet_absolute(
            arrays, height - lowered + lift_m, reach + lift_m * (np.arange(reach.size) == 0), self.time_step_s,
            self.steps_per_sample, samples, attraction=self.attraction, local_damping=self.local_damping,
        )  # fmt: skip

    @property
    def start_velocity_m_s(self) -> Array:
        """Velocities at time 0 with which the integrator starts as the code does. Shape (bodies,)."""
        velocity, acceleration = self.chain.velocity_m_s, self.chain.acceleration_m_s2
        step = self.time_step_s * acceleration * (1 - self.local_damping * np.sign(acceleration * velocity))
        own_step = self.case.scene.time_step_s * self.case.chain.acceleration_m_s2
        return np.asarray(velocity + self.ahead * step + (0.5 * (step - own_step) if self.staggered else 0.0))

    def readings(self, force_N: Array) -> Iterator[Array]:
        """Contact forces as adapters read them: each, or summed from the lowest up with the loads of the scene.

        The latter, ``F_{j+1} = F_j - (f_j - load_j)`` with f the total forces on bodies, goes wrong with the loads.
        """
        yield force_N
        excess = np.cumsum(self.chain.load_N - self.case.chain.load_N)
        if excess.any():
            yield force_N - np.append(0.0, excess[:-1])


@dataclass(frozen=True)
class Variant:
    """Models with one thing wrong.

    Attributes:
        kind: what is wrong, short.
        words: what it is, to follow "matches"; with fields that ``described`` fills in.
        at: the model at a value, which is above zero.
        values: values to begin with; none where the variant has no parameter.
        own: what the scene has instead.
        unit: what a value counts in the sentence.
        default: value that a code takes where its deck says nothing, and the code.
    """

    kind: str
    words: str
    at: Callable[[float], Model]
    values: Array = field(default_factory=lambda: np.zeros(0))
    own: str = ""
    unit: float = 1.0
    default: tuple[float | None, str] = (None, "")

    def described(self, value: float) -> str:
        """What the variant is at a value."""
        if not self.values.size:
            return self.words
        default, code = self.default
        note = f", which {code} has unless told" if default and abs(value / default - 1) < 1e-6 else ""
        told = number(restitution_with_attraction(value)) if "{told}" in self.words else ""
        return self.words.format(value=number(value * self.unit), own=self.own, note=note, told=told)


def model_of(case: Case, engine: str) -> Model:
    """The case as it should be on an engine."""
    scene, exact = case.scene, load_engine(engine).scheme == EXACT
    return Model(case, case.chain, scene.time_step_s, scene.steps_per_sample, exact)


def number(value: float) -> str:
    """A number for a sentence, told from 1."""
    return f"{value:.6g}" if value == 1 or abs(value - 1) > 1e-4 else f"(1 {value - 1:+.3g})"


def plain_variants(model: Model, engine: str) -> Iterator[Variant]:
    """Those without a parameter, the plainest first."""
    chain, scene, dt, every = model.chain, model.case.scene, model.time_step_s, model.steps_per_sample
    if chain.gravity_m_s2:
        load_N = chain.load_N + chain.gravity_m_s2 * chain.mass_kg
        yield _plain(model, "gravity", "the scene without gravity", load_N=load_N)
    if chain.precompression_N:
        load_N = chain.load_N + chain.precompression_N * (np.arange(chain.bodies) == chain.beads - 1)
        yield _plain(model, "precompression", "the scene without its precompression", load_N=load_N)
    if scene.striker is not None:
        resting, rising = (model.scaled("velocity_m_s", [-1], factor) for factor in (0.0, -1.0))
        for each in (resting, resting.having(ahead=0.5)):  # at rest at time 0, or half a step before
            yield _plain(each, "striker speed", "a striker at rest")
        yield _plain(rising, "striker speed", "a striker that moves upwards")
    for ahead, place in ((0.5, "ahead"), (-0.5, "behind")):
        words = f"velocities that start half a step {place}, as symplectic Euler has them"
        yield _plain(model, "velocity shift", f"{words}; a step is {number(dt * 1e6)} us", ahead=ahead)
    if chain.damping_ratio:
        yield _plain(model, "damping", "contacts that lose no energy", damping_ratio=0.0)
    for other in sorted({every * 2, every * 10} | {every // n for n in (2, 10) if every % n == 0}):
        step = dt * every / other
        words = f"a time step of {number(step * 1e6)} us (the scene has {number(dt * 1e6)})"
        yield _plain(model, "time step", words, time_step_s=step, steps_per_sample=other)
    yield from _materials(model, engine)
    for words, overlap_m in (
        ("beads that start just touching, not in equilibrium", np.minimum(chain.overlap_m, 0.0)),
        ("beads that start without their gaps", np.maximum(chain.overlap_m, 0.0)),
    ):
        if (overlap_m != chain.overlap_m).any():
            yield _plain(model, "placing", words, overlap_m=overlap_m)


def families(model: Model, engine: str) -> Iterator[Variant]:
    """Those of the whole chain, its wall or its striker with a parameter, the plainest first."""
    chain, defaults, code = model.chain, load_engine(engine).defaults, engine.upper()
    beads, everything = list(range(chain.beads)), list(range(chain.bodies))
    striker, gauges = everything[chain.beads :], [each.from_wall - 1 for each in model.case.scene.chain.sensors]
    if chain.wall:
        words = "a wall contact {value} times as stiff ({own} takes 1{note})"
        wall = _scaled(model, "wall contact", words, "stiffness", [0])
        yield replace(wall, own=chain.wall, default=(defaults.wall_stiffness, code))
    for kind, words, name, places in (
        ("bead contacts", "contacts of beads {value} times as stiff", "stiffness", beads[1:]),
        ("striker contact", "a striker's contact {value} times as stiff", "stiffness", striker),
        ("all contacts", "all contacts {value} times as stiff", "stiffness", everything),
        ("striker mass", "a striker weighing {value} g (the scene has {own})", "mass_kg", striker),
        ("sensor mass", "sensor beads {value} times as heavy", "mass_kg", gauges if len(gauges) > 1 else []),
        ("bead masses", "beads {value} times as heavy", "mass_kg", beads),
        ("all masses", "all bodies {value} times as heavy", "mass_kg", everything),
        ("striker speed", "a striker at {value} m/s (the scene has {own})", "velocity_m_s", striker),
    ):
        if places:
            yield _scaled(model, kind, words, name, places)
    if model.exact:
        return
    yield Variant(
        "local damping", "non-viscous damping of {value}{note}", lambda t: model.having(local_damping=min(t, 1.0)),
        RATIOS[RATIOS < 1], default=(defaults.local_damping, code),
    )  # fmt: skip
    own, dt_us = chain.damping_ratio, model.time_step_s * 1e6
    laws = [(False, "without attraction"), (True, "which may pull")]
    for pulls, law in laws if own else laws[::-1]:  # the law of the scene first, if it has one
        words = (
            f"contacts of damping ratio {{value}}, {law} (the scene has {{own}}; a coefficientRestitution of {{told}})"
        )
        yield Variant("damping", words, partial(_damped, model, pulls), RATIOS, number(own))
    words = "a time step of {value} us (the scene has {own}) at stamps of the scene's"
    slower = lambda t: model.having(time_step_s=t * model.time_step_s)  # noqa: E731
    yield Variant("time step", words, slower, FACTORS, number(dt_us), dt_us)


def single_families(model: Model, places: Sequence[int]) -> Iterator[Variant]:
    """Those of single contacts and beads, by their places from 0."""
    beads = [j for j in places if j < model.chain.beads]
    for j in beads:
        words = f"contact {j + 1} {{value}} times as stiff"
        yield _scaled(model, f"contact {j + 1}", words, "stiffness", [j])
    for j in beads:
        words = f"bead {j + 1} weighing {{value}} g (the scene has {{own}})"
        yield _scaled(model, f"mass of bead {j + 1}", words, "mass_kg", [j])


def _plain(model: Model, kind: str, words: str, **changes: Any) -> Variant:
    changed = model.having(**changes)
    return Variant(kind, words, lambda _: changed)


def _scaled(model: Model, kind: str, words: str, name: str, places: Sequence[int]) -> Variant:
    """Values of an array times a factor; in the sentence masses and speeds are those of the first place."""
    first = abs(float(getattr(model.chain, name)[places[0]])) * (1e3 if name == "mass_kg" else 1.0)
    unit = first if "the scene has" in words else 1.0
    return Variant(kind, words, partial(model.scaled, name, places), FACTORS, number(first), unit)


def _damped(model: Model, pulls: bool, ratio: float) -> Model:
    return model.having(damping_ratio=ratio, attraction=pulls)


def _materials(model: Model, engine: str) -> Iterator[Variant]:
    """Another material of the wall, the beads, the striker or wherever a name stands; constants that are forgotten."""
    chain, known = model.chain, _known_materials(model.case)
    names = [chain.wall, *chain.materials]
    used = list(dict.fromkeys(name for name in [*chain.materials, chain.wall] if name))
    named = {name: [j for j, own in enumerate(names) if own == name] for name in used}
    roles = {"a wall of": [0]} if chain.wall else {}
    roles |= {"beads of": list(range(1, chain.beads + 1))}
    roles |= {f"{name} taken for": places for name, places in named.items()}
    swaps: list[tuple[str, list[int], Mapping[str, Material | None]]] = [
        (f"{role} {other}", places, dict.fromkeys(used, known[other]))
        for role, places in roles.items()
        for other in known
        if places and (known[other] or places == [0])  # only walls are rigid
    ]
    swaps += [
        (
            f"{who} with {words} that {engine.upper()} has unless told",
            places,
            {n: _completed(known[n], c) for n in used},
        )
        for words, c in _constants(load_engine(engine).defaults)
        for who, places in [("all materials", list(range(len(names)))), *named.items()]
    ]
    for words, places, others in swaps:
        own = [known[name] if name else None for name in names]
        changed = [others[name] if name and j in places else own[j] for j, name in enumerate(names)]
        stiffness = _stiffness(chain, changed)
        if not np.array_equal(stiffness, chain.stiffness):
            yield _plain(model, "material", words, stiffness=stiffness)


def _constants(defaults: Defaults) -> Iterator[tuple[str, dict[str, float]]]:
    """Elastic constants, one or both, that a code has unless told, in words."""
    modulus, ratio = defaults.youngs_modulus_Pa, defaults.poisson_ratio
    if modulus is not None and ratio is not None:
        words = f"Young's modulus of {number(modulus / 1e9)} GPa"
        yield f"the Poisson's ratio of {ratio}", {"poisson_ratio": ratio}
        yield f"the {words}", {"youngs_modulus": modulus}
        yield f"the {words} and Poisson's ratio of {ratio}", {"youngs_modulus": modulus, "poisson_ratio": ratio}


def _known_materials(case: Case) -> dict[str, Material | None]:
    """Materials by name: the scene's before those of the library, and the one that does not yield."""
    library = {name: validate(Material, table, name) for name, table in read_toml(paths.MATERIALS).items()}
    return {**library, **case.scene.materials, RIGID: None}


def _completed(material: Material | None, constants: dict[str, float]) -> Material | None:
    """A material with some constants of another; one that does not yield has a ratio of 0 and no end of a modulus."""
    if material is not None:
        return material.model_copy(update=constants)
    rigid = {"poisson_ratio": 0.0, "youngs_modulus": inf} | constants
    return Material.model_construct(None, **rigid)


def _stiffness(chain: Chain, materials: Sequence[Material | None]) -> Array:
    """Hertz stiffness of the contact under each body, for materials of the wall and the bodies. Shape (bodies,)."""
    radius = [inf, *map(float, chain.radius_m)]
    stiffness = np.zeros(chain.bodies)
    for j in map(int, np.flatnonzero(chain.stiffness)):
        stiffness[j] = hertz_stiffness(materials[j + 1], radius[j + 1], materials[j], radius[j])
    return stiffness
