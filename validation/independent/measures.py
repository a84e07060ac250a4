"""All measures by name: a further one is a module of its own and a line here."""

from validation.independent import collision, impact, linear, solitary, train, wall, weak
from validation.independent.case_measure import Measure

MEASURES: dict[str, Measure] = {
    "collision": collision.COLLISION,
    "impact": impact.IMPACT,
    "small signal": linear.LINEAR,
    "solitary wave": solitary.SOLITARY,
    "train": train.TRAIN,
    "wall": wall.WALL,
    "weak strike": weak.WEAK,
}
