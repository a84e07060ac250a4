"""What a run is expected to cost, and the cheapest engine that can model a case: ``inputs/costs.toml``."""

import tomllib
from dataclasses import dataclass
from functools import cache

from drivers.base import paths
from drivers.base.errors import RunError
from drivers.chain.case import Case
from drivers.engines import engine_names, installed, load_engine
from drivers.limits.refusal import beyond_rounding


@dataclass(frozen=True)
class Cost:
    """Cost of a run on one engine: seconds of start-up, nanoseconds per body and time step, and body and sample."""

    start_s: float
    step_ns: float
    sample_ns: float

    def loop_s(self, case: Case) -> float:
        """Seconds in the time loop."""
        return case.chain.bodies * (self.step_ns * case.scene.steps + self.sample_ns * case.scene.samples) * 1e-9

    def run_s(self, case: Case) -> float:
        """Seconds of a whole process."""
        return self.start_s + self.loop_s(case)


@cache
def cost_on(engine: str) -> Cost:
    """What an engine costs; one that nobody has measured costs infinitely much."""
    measured = tomllib.loads(paths.COSTS.read_text()).get(engine)
    return Cost(**measured) if measured else Cost(float("inf"), 0.0, 0.0)


def able(case: Case) -> list[str]:
    """Engines that model all that the case requires, as accurately as it asks, installed or not."""
    needed = {element.name for element in case.elements if element.modelled}
    return [
        name
        for name in engine_names()
        if needed <= load_engine(name).models
        and not beyond_rounding(case, name)
        and load_engine(name).refusal(case) is None
    ]


def cheapest(case: Case) -> str:
    """The cheapest installed engine that models all that the case requires.

    Raises:
        RunError: there is none.
    """
    found = installed(able(case))
    if not found:
        raise RunError(f"no installed engine models all of this scene; {', '.join(able(case)) or 'none'} would")
    return min(found, key=lambda name: cost_on(name).run_s(case))
