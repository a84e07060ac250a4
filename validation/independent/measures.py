"""All measures by name: a further one is a module of its own and a line here."""

from validation.independent import impact, solitary, train, wall
from validation.independent.measure import Measure

MEASURES: dict[str, Measure] = {
    "impact": impact.IMPACT,
    "solitary wave": solitary.SOLITARY,
    "train": train.TRAIN,
    "wall": wall.WALL,
}
