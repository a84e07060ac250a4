"""All measures by name: a further one is a module of its own and a line here."""

from validation.independent import impact
from validation.independent.measure import Measure

MEASURES: dict[str, Measure] = {
    "impact": impact.IMPACT,
}
