"""Variants of a case: models with one fault of a deck, with at most one parameter, and misread records."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from math import inf
from typing import Any

import numpy as np

from drivers.base import paths
from drivers.base.messages import validate
from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, arrays_of, build_chain, stiffness_by
from drivers.chain.contact_law import hertz_stiffness, restitution_with_attraction
from drivers.chain.schemes import heights_and_reach
from drivers.engines import load_engine
from drivers.scene.model import RIGID, Material
from drivers.scene.read_scene import read_toml
from validation.accuracy.step_choice import REMOVALS
from validation.reference.hertz_chain import Motion
from validation.reference.velocity_verlet import integrate_verlet_absolute

FACTORS = np.logspace(-1.7, 1.7, 41)
RATIOS = np.logspace(-6, 0.5, 30)
MAX_VALUES = 4_000_000  # of a motion recorded at every step
Misreading = tuple[str, str, Array, slice]  # kind, words, misread values, samples that have values


@dataclass(frozen=True)
class Model:
    """A case as a faulty deck may have it.

    Attributes:
        case: the correct case.
        chain: the chain of the faulty deck; other overlaps move the bodies.
        ahead: time steps by which the start velocities are ahead of those of the chain.
        staggered: True if the deck sets velocities at half a step before time 0, by the case's step and accelerations.
        attraction, local_damping: as in ``integrate_verlet_absolute``.
    """

    case: Case
    chain: Chain
    time_step_s: float
    steps_per_sample: int
    ahead: float = 0.0
    staggered: bool = False
    attraction: bool = False
    local_damping: float = 0.0

    def having(self, **changes: Any) -> "Model":
        """Copy with other attributes or other arrays of the chain; the weights follow the masses."""
        own = {name: changes.pop(name) for name in list(changes) if name in self.__dataclass_fields__}
        if "mass_kg" in changes:
            heavier = changes["mass_kg"] - self.chain.mass_kg
            changes["load_N"] = self.chain.load_N - self.chain.gravity_m_s2 * heavier
        return replace(self, chain=replace(self.chain, **changes), **own)

    def scaled(self, name: str, places: Sequence[int], factor: float) -> "Model":
        """Copy with some values of an array of the chain multiplied by a factor."""
        array = getattr(self.chain, name).copy()
        array[places] *= factor
        return self.having(**{name: array})

    def motion(self, samples: int, lift_m: float = 0.0) -> Motion:
        """Motion from time 0; lifting all heights changes rounding errors only."""
        arrays = replace(arrays_of(self.chain), velocity_m_s=self.start_velocity_m_s)
        height, reach = heights_and_reach(self.case)
        lowered = np.cumsum(self.chain.overlap_m - self.case.chain.overlap_m)
        return integrate_verlet_absolute(
            arrays, height - lowered + lift_m, reach + lift_m * (np.arange(reach.size) == 0), self.time_step_s,
            self.steps_per_sample, samples, attraction=self.attraction, local_damping=self.local_damping,
        )  # fmt: skip

    @property
    def start_velocity_m_s(self) -> Array:
        """Velocities at time 0 that make the integrator start as the code does. Shape (bodies,)."""
        velocity, acceleration = self.chain.velocity_m_s, self.chain.acceleration_m_s2
        step = self.time_step_s * acceleration * (1 - self.local_damping * np.sign(acceleration * velocity))
        own_step = self.case.scene.time_step_s * self.case.chain.acceleration_m_s2
        return np.asarray(velocity + self.ahead * step + (0.5 * (step - own_step) if self.staggered else 0.0))

    def readings(self, force_N: Array) -> Iterator[Array]:
        """Contact forces as adapters read them: directly, or summed from the wall up with the loads of the scene.

        The sum ``F_{j+1} = F_j - (f_j - load_j)``, f being the total forces on bodies, is wrong if the loads are.
        """
        yield force_N
        excess = np.cumsum(self.chain.load_N - self.case.chain.load_N)
        if excess.any():
            yield force_N - np.append(0.0, excess[:-1])


@dataclass(frozen=True)
class Variant:
    """A family of models with one fault.

    Attributes:
        kind: kind of the fault.
        words: function that describes the fault at a value, to follow "matches".
        at: function that returns the model at a value above zero.
        values: initial values; empty for a variant without a parameter.
    """

    kind: str
    words: Callable[[float], str]
    at: Callable[[float], Model]
    values: Array = field(default_factory=lambda: np.zeros(0))


def model_of(case: Case) -> Model:
    """Model of the correct case."""
    return Model(case, case.chain, case.scene.time_step_s, case.scene.steps_per_sample)


def number(value: float) -> str:
    """Text of a number, with enough digits to differ from 1."""
    return f"{value:.6g}" if value == 1 or abs(value - 1) > 1e-4 else f"(1 {value - 1:+.3g})"


def plain_variants(model: Model, engine: str) -> Iterator[Variant]:
    """Variants without a parameter, the simplest first."""
    chain, scene, dt, every = model.chain, model.case.scene, model.time_step_s, model.steps_per_sample
    for kind, words, has in (
        ("gravity", "the scene without gravity", chain.gravity_m_s2),
        ("precompression", "the scene without its precompression", chain.precompression_N),
    ):
        if has:
            yield _plain(model, kind, words, load_N=build_chain(REMOVALS[kind](scene)).load_N)
    if scene.striker is not None:
        resting, rising = (model.scaled("velocity_m_s", [-1], factor) for factor in (0.0, -1.0))
        for each in (resting, resting.having(ahead=0.5)):  # at rest at time 0 or half a step before
            yield _plain(each, "striker speed", "a striker at rest")
        yield _plain(rising, "striker speed", "a striker that moves upwards")
    for ahead, place in ((0.5, "ahead"), (-0.5, "behind")):
        words = f"velocities that start half a step {place}, as in symplectic Euler"
        yield _plain(model, "velocity shift", f"{words} (step {number(dt * 1e6)} µs)", ahead=ahead)
    if chain.damped:
        yield _plain(model, "damping", "contacts that lose no energy", damping_ratio=0.0, gamma=0.0, alpha=0.0)
    for other in sorted({every * 2, every * 10} | {every // n for n in (2, 10) if every % n == 0}):
        step = dt * every / other
        words = f"a time step of {number(step * 1e6)} µs (the scene has {number(dt * 1e6)})"
        yield _plain(model, "time step", words, time_step_s=step, steps_per_sample=other)
    yield from _materials(model, engine)
    for words, overlap_m in (
        ("beads that start just touching, not in equilibrium", np.minimum(chain.overlap_m, 0.0)),
        ("beads that start without their gaps", np.maximum(chain.overlap_m, 0.0)),
    ):
        if (overlap_m != chain.overlap_m).any():
            yield _plain(model, "placing", words, overlap_m=overlap_m)


def _plain(model: Model, kind: str, words: str, **changes: Any) -> Variant:
    changed = model.having(**changes)
    return Variant(kind, lambda _: words, lambda _: changed)


def _materials(model: Model, engine: str) -> Iterator[Variant]:
    """Variants with another material of the wall, of the beads or under a name, and with default elastic constants."""
    chain, scene, defaults = model.chain, model.case.scene, load_engine(engine).defaults
    library = {name: validate(Material, table, name) for name, table in read_toml(paths.MATERIALS).items()}
    yielding = library | scene.materials
    known = yielding | {RIGID: Material.model_construct(None, youngs_modulus=inf, poisson_ratio=0.0)}
    wall, bodies = chain.wall, list(chain.materials)
    used = list(dict.fromkeys([*bodies, *([wall] if wall else [])]))
    swaps: list[tuple[str, dict[str, Material], str | None, list[str]]]
    swaps = [(f"a wall of {other}", known, other, bodies) for other in known if wall]
    swaps += [(f"beads of {n}", known, wall, [n] * chain.beads + bodies[chain.beads :]) for n in yielding]
    swaps += [(f"{o} in place of {n}", known | {n: known[o]}, wall, bodies) for n in used for o in yielding]
    modulus, ratio = defaults.youngs_modulus_Pa, defaults.poisson_ratio
    if modulus is not None and ratio is not None:
        young = f"Young's modulus of {number(modulus / 1e9)} GPa"
        for words, constants in (
            (f"Poisson's ratio of {ratio}", {"poisson_ratio": ratio}),
            (young, {"youngs_modulus": modulus}),
            (f"{young} and Poisson's ratio of {ratio}", {"youngs_modulus": modulus, "poisson_ratio": ratio}),
        ):
            for who, names in (("all materials", used), *((name, [name]) for name in used)):
                completed = {name: known[name].model_copy(update=constants) for name in names}
                text = f"{who} with {engine.upper()}'s default {words}"
                swaps.append((text, known | completed, wall, bodies))
    for words, materials, under, names in swaps:
        standing = scene.wall and scene.wall.model_copy(update={"material": under})
        other = scene.model_copy(update={"materials": materials, "wall": standing})
        stiffness = stiffness_by(hertz_stiffness, other, names, chain.radius_m)
        if not np.array_equal(stiffness, chain.stiffness):
            yield _plain(model, "material", words, stiffness=stiffness)


def families(model: Model, engine: str) -> Iterator[Variant]:
    """Variants with a parameter of the whole chain, its wall or its striker, the simplest first."""
    chain, defaults = model.chain, load_engine(engine).defaults
    beads, everything = list(range(chain.beads)), list(range(chain.bodies))
    striker, gauges = everything[chain.beads :], [each.from_wall - 1 for each in model.case.scene.chain.sensors]

    walls, own, dt_us = defaults.wall_stiffness, chain.damping_ratio, model.time_step_s * 1e6

    def note(value: float, default: float | None) -> str:
        same = default and abs(value / default - 1) < 1e-6
        return f", the default of {engine.upper()}" if same else ""

    def damping(pulls: bool, law: str) -> Variant:
        def words(ratio: float) -> str:
            liggghts = f"coefficientRestitution of {number(restitution_with_attraction(ratio))}"
            return f"contacts of damping ratio {number(ratio)}, {law} (the scene has {number(own)}; {liggghts})"

        return Variant(
            "damping", words, lambda t: model.having(damping_ratio=t, gamma=0.0, alpha=0.0, attraction=pulls), RATIOS
        )

    if chain.wall:
        yield Variant(
            "wall contact",
            lambda t: f"a wall contact {number(t)} times as stiff as with {chain.wall}{note(t, walls)}",
            partial(model.scaled, "stiffness", [0]), FACTORS,
        )  # fmt: skip
    for kind, words, name, places in (
        ("bead contacts", "contacts of beads {times} times as stiff", "stiffness", beads[1:]),
        ("striker contact", "a striker's contact {times} times as stiff", "stiffness", striker),
        ("all contacts", "all contacts {times} times as stiff", "stiffness", everything),
        ("striker mass", "a striker weighing {value} g (the scene has {own})", "mass_kg", striker),
        ("sensor mass", "sensor beads {times} times as heavy", "mass_kg", gauges if len(gauges) > 1 else []),
        ("bead masses", "beads {times} times as heavy", "mass_kg", beads),
        ("all masses", "all bodies {times} times as heavy", "mass_kg", everything),
        ("striker speed", "a striker at {value} m/s (the scene has {own})", "velocity_m_s", striker),
    ):
        if places:
            yield _scaled(model, kind, words, name, places)
    yield Variant(
        "local damping", lambda t: f"non-viscous damping of {number(t)}{note(t, defaults.local_damping)}",
        lambda t: model.having(local_damping=min(t, 1.0)), RATIOS[RATIOS < 1],
    )  # fmt: skip
    laws = [(False, "without attraction"), (True, "with attraction")]
    for pulls, law in laws if own else laws[::-1]:  # the law of a damped scene first
        yield damping(pulls, law)
    yield Variant(
        "time step",
        lambda t: f"a time step of {number(t * dt_us)} µs (the scene has {number(dt_us)}) with the scene's time stamps",
        lambda t: model.having(time_step_s=t * model.time_step_s), FACTORS,
    )  # fmt: skip


def single_families(model: Model, places: Sequence[int]) -> Iterator[Variant]:
    """Variants of single contacts and beads, given by indices from 0."""
    beads = [j for j in places if j < model.chain.beads]
    for j in beads:
        yield _scaled(model, f"contact {j + 1}", f"contact {j + 1} {{times}} times as stiff", "stiffness", [j])
    for j in beads:
        words = f"bead {j + 1} weighing {{value}} g (the scene has {{own}})"
        yield _scaled(model, f"mass of bead {j + 1}", words, "mass_kg", [j])


def _scaled(model: Model, kind: str, words: str, name: str, places: Sequence[int]) -> Variant:
    """Variant with some values of an array times a factor; the text names the value at the first place."""
    own = abs(float(getattr(model.chain, name)[places[0]])) * (1e3 if name == "mass_kg" else 1.0)

    def described(times: float) -> str:
        return words.format(times=number(times), value=number(times * own), own=number(own))

    return Variant(kind, described, partial(model.scaled, name, places), FACTORS)


def misread_forces(model: Model, found_N: Array) -> Iterator[Misreading]:
    """Misread forces of a case; factors are fitted to the recorded forces, of shape (samples, bodies)."""
    whole, late, (samples, bodies) = slice(None), slice(1, None), found_N.shape
    later, every = model.motion(samples + 1).force_N, model.steps_per_sample
    right = later[:-1]
    yield "time stamps", "forces stamped 1 sample early", later[1:], whole
    yield "time stamps", "forces stamped 1 sample late", np.vstack([right[:1], right[:-1]]), late
    if every > 1 and samples * every * bodies <= MAX_VALUES:
        words = f"forces stamped one time step ({number(model.time_step_s * 1e6)} µs)"
        steps = replace(model, steps_per_sample=1).motion(samples * every + 1).force_N
        yield "time stamps", f"{words} early", steps[1::every][:samples], whole
        before = steps[every - 1 :: every][: samples - 1]
        yield "time stamps", f"{words} late", np.vstack([right[:1], before]), late
    yield "sign", "forces of the other sign", -right, whole
    yield "order", "contacts in the opposite order", right[:, ::-1], whole
    below = np.append(0.0, np.cumsum(model.chain.load_N)[:-1])
    yield "static forces", "forces summed without the loads", right - below, whole
    factor = float((found_N * right).sum() / ((right**2).sum() or 1.0))
    yield "factor", f"forces times {number(factor)}", factor * right, whole


def misread_velocities(model: Model, right: Motion) -> Iterator[tuple[str, Array]]:
    """Misread velocities of a case: words and values of shape (samples, bodies)."""
    above_N = np.pad(right.force_N, ((0, 0), (0, 1)))[:, 1:]
    change = 0.5 * model.time_step_s * (right.force_N - above_N + model.chain.load_N) / model.chain.mass_kg
    size = f"({number(model.time_step_s * 0.5e6)} µs)"
    yield f"velocities half a step {size} early", right.velocity_m_s + change
    yield f"velocities half a step {size} late", right.velocity_m_s - change
    yield "velocities of the other sign", -right.velocity_m_s
