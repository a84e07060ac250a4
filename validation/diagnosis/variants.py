"""What a variant is: the model with a fault, in words; with a parameter, a family of them."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from drivers.chain.chain import Array
from validation.diagnosis.faulty_model import Model

FACTORS = np.log(50) * np.linspace(-1, 1, 53)  # logarithms of factors, 1.16 apart
MOST_PLACES = 60  # contacts of a chain that are left out, or swapped, one by one
FURTHEST = 30.0  # logarithm that a fit may try
FEW_FACTORS = FACTORS[::2]
BEHIND_BY_THE_SCENES = ", with velocities that are set back by half the scene's step"
BOTH_SIGNS = np.concatenate([-np.logspace(1, -5, 25), [0.0], np.logspace(-5, 1, 25)])


@dataclass(frozen=True)
class Variant:
    """The model with a fault.

    Attributes:
        kind: what is at fault, short.
        words: what it is, to follow "matches".
    """

    kind: str
    words: str
    model: Model


@dataclass(frozen=True)
class Family:
    """Variants by a parameter.

    Attributes:
        at: the model at a value.
        words: what it is at a value, to follow "matches".
        start: values to begin with; the scene's own is 0 unless ``neutral`` says otherwise.
        size: of small changes, for slopes at 0.
    """

    kind: str
    words: Callable[[float], str]
    at: Callable[[float], Model]
    start: Array
    neutral: float = 0.0
    size: float = 1.0

    @property
    def additive(self) -> bool:
        """Whether values differ by orders of magnitude, not by factors."""
        return self.size < 1


def by_factor(kind: str, words: Callable[[float], str], at: Callable[[float], Model], start: Array = FACTORS) -> Family:
    """A family by a factor, whose logarithm is the parameter."""
    return Family(kind, lambda t: words(_exp(t)), lambda t: at(_exp(t)), start)


def _exp(t: float) -> float:
    return float(np.exp(np.clip(t, -FURTHEST, FURTHEST)))


def number(value: float, digits: int = 6) -> str:
    """A number for a sentence."""
    return f"{value:.{digits}g}"


def of_one(factor: float) -> str:
    """A factor for a sentence, such that it is told from 1."""
    return number(factor) if abs(factor - 1) > 1e-4 else f"(1 {'+' if factor > 1 else '-'} {abs(factor - 1):.3g})"


def weighing(model: Model, mass_kg: Array, gravity_m_s2: float) -> Model:
    """The model with other masses, and the weights that go with them."""
    return replace(model, mass_kg=mass_kg, load_N=model.load_N - gravity_m_s2 * (mass_kg - model.mass_kg))


def behind_by(model: Model, time_step_s: float) -> Model:
    """The model with start velocities that are set back by half of another step than its own."""
    return replace(model, ahead=0.5 * (1 - time_step_s / model.time_step_s))


def scaled_at(array: Array, places: slice | int | list[int], factor: float) -> Array:
    """A copy with some values multiplied."""
    result = array.copy()
    result[places] *= factor
    return result


def conventions(model: Model) -> list[Model]:
    """The model as codes differ in starting it: by velocities of time 0, or of half a step before as the scene has it.

    They are the same wherever the forces at time 0 are those of the scene.
    """
    return [replace(model, staggered=staggered) for staggered in (False, True)]
