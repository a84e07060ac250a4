"""The file ``inputs/calibration.toml``: ranges, laws, quoted data, and the choices that the experiment leaves open."""

from functools import cache
from itertools import product
from typing import Annotated, Literal

from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import validate
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml

Texts = Annotated[tuple[str, ...], Field(strict=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Range(Part):
    """Range of a parameter; quantities are text such as "1 GPa". At the value ``none`` it has no effect."""

    low: str | float
    high: str | float
    start: str | float | None = None
    none: float | None = None
    because: str


class Nuisance(Part):
    """Parameter of all quoted numbers of one kind that the paper does not state, as an option of ``--free``."""

    key: Literal["force_scale", "speed_scale", "cut"]
    free: str
    because: str


class QuotedNumber(Part):
    """A number of ``inputs/paper/quoted.toml`` as a datum.

    Attributes:
        scale: factor from the quoted unit to that of the observable.
        error: relative standard error, or the kind of number whose error the paper states.
        rounding: half of the last digit, in the quoted unit; one for each number of a list.
    """

    observable: str
    quoted: str
    scale: float = 1.0
    error: Literal["force", "speed"] | Positive
    rounding: Annotated[tuple[Positive, ...], Field(strict=False)] = ()
    because: str = ""


class QuotedSet(Part):
    """Quoted data of a scene; a list of numbers gives one data set per row.

    ``also`` maps a data set to the row with the same experiment; this row is left out if both are fitted.
    """

    name: str
    scene: str
    set: Texts = ()
    own: Texts = ()
    also: dict[str, int] = Field(default_factory=dict)
    number: Annotated[tuple[QuotedNumber, ...], Field(strict=False, min_length=1)]


class Answer(Part):
    """One reading of a sentence of the paper.

    Attributes:
        set: settings by data set.
        free: further free parameters.
        read: observables to be read in place of others.
        fixed: values of nuisance parameters.
        independent: True if no error is common to several numbers.
    """

    name: str
    because: str = ""
    set: dict[str, Texts] = Field(default_factory=dict)
    free: Texts = ()
    read: dict[str, str] = Field(default_factory=dict)
    fixed: dict[str, float] = Field(default_factory=dict)
    independent: bool = False


class Choice(Part):
    """A question that the paper leaves open, with its answers; the first is the one taken by default.

    Attributes:
        alone: True to vary it with the default answers to all other questions only.
        quick: True to vary it in the short study.
    """

    name: str
    alone: bool = False
    quick: bool = False
    answer: Annotated[tuple[Answer, ...], Field(strict=False, min_length=2)]


class Law(Part):
    """A contact law, given by settings, and the free parameters of its dissipation.

    Attributes:
        found: parameters found on the paper, by label; the short study starts there alone.
    """

    name: str
    set: Texts = ()
    free: Texts = ()
    found: dict[str, float] = Field(default_factory=dict)


class CalibrationFile(Part):
    """The whole file.

    Attributes:
        range: ranges by key of the scene, or by the last part of a key.
        data: data sets of the calibration on the paper.
        free: parameters that every law has in it.
    """

    range: dict[Annotated[str, Field(min_length=1)], Range]
    data: Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
    free: Texts
    law: Annotated[tuple[Law, ...], Field(strict=False, min_length=1)]
    nuisance: Annotated[tuple[Nuisance, ...], Field(strict=False)]
    set: Annotated[tuple[QuotedSet, ...], Field(strict=False, min_length=1)]
    choice: Annotated[tuple[Choice, ...], Field(strict=False, min_length=1)]

    def law_named(self, name: str) -> Law:
        """The law with this name; InputError if there is none."""
        for law in self.law:
            if law.name == name:
                return law
        raise InputError("--law", "", name, ", ".join(law.name for law in self.law))

    def readings(self, *, quick: bool = False) -> list[tuple[Answer, ...]]:
        """Combinations of answers, the default first; the short study varies some questions only."""
        every = [
            *product(*(choice.answer if choice.quick or not quick else choice.answer[:1] for choice in self.choice))
        ]
        asked = []
        for answers in every:  # a question that is varied alone is not combined with another one
            pairs = zip(self.choice, answers, strict=True)
            other = [choice for choice, answer in pairs if answer is not choice.answer[0]]
            if len(other) < 2 or not any(choice.alone for choice in other):
                asked.append(answers)
        return asked


@cache
def calibration_file() -> CalibrationFile:
    """Contents of the file.

    Raises:
        InputError: the file has errors.
    """
    return validate(CalibrationFile, read_toml(paths.CALIBRATION), paths.shown(paths.CALIBRATION))
