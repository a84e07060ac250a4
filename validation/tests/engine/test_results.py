"""Results of an engine: scenes, order of convergence, restitution, blow-up, changed decks."""

from contextlib import suppress
from math import log2
from typing import Any

import numpy as np
import pytest

from drivers.base.errors import RunError
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.trace import REST_SHARE, Trace, residual
from drivers.limits import step_limit
from drivers.run.scheme import UNSTABLE
from validation.accuracy.motions import exact_motion_of
from validation.tests.engine.candidate import Candidate, case_of_variant, case_with, kit

STABLE_SHARE = 0.98  # of the largest stable step: a step at which a run has to be stable
PASSES = 1.5  # times the first unstable step: a step at which bodies pass through each other
PRECOMPRESSION = ("chain.precompression=20 N", "run.duration=1 ms")  # closed contacts make the limit sharp
COLLISION = ("gravity=", "tube=", "run.duration=0.4 ms", "run.time_step=0.02 us")
IMPACTS = {"two beads": (*COLLISION, "chain.count=1", "wall="), "a bead on the wall": (*COLLISION, "chain.count=0")}
LAWS = {2: (), 1: ("contact.restitution=0.9",)}  # by order: elastic, damped
RESTITUTIONS = (0.3, 0.8, 0.99)
STEPS = (5, 10, 20)  # steps per sample for the order of convergence


@pytest.mark.parametrize("variant", kit()["variant"], ids=lambda variant: variant["name"].replace(" ", "-"))
def test_scene(candidate: Candidate, variant: dict[str, Any]) -> None:
    """Forces, energy and momentum are those of the engine's scheme, with which the guard compares them."""
    candidate.run(case_of_variant(variant))


@pytest.mark.parametrize("expected", LAWS, ids=["elastic", "damped"])
def test_order(candidate: Candidate, expected: int) -> None:
    """Errors converge with the order of the scheme."""
    if not candidate.steps:
        pytest.skip("the engine has no time step")
    case = case_with(*LAWS[expected])
    exact = exact_motion_of(case, finer=False).trace
    errors = [float(residual(candidate.run(case.at(steps)), exact).max()) for steps in STEPS]
    assert log2(errors[1] / errors[2]) == pytest.approx(expected, abs=tolerance("kit", "order").limit), errors


@pytest.mark.parametrize("wanted", RESTITUTIONS)
@pytest.mark.parametrize("impact", IMPACTS)
def test_restitution(candidate: Candidate, impact: str, wanted: float) -> None:
    """Impacts have the restitution of the scene and no attraction."""
    case = case_with(*IMPACTS[impact], f"contact.restitution={wanted}")
    trace = candidate.run(case)
    assert trace.force_N.min() >= -1e-12 * trace.force_N.max(), "contacts pull"
    error = abs(bounced(case, trace) / wanted - 1) / (1 - wanted)  # as a part of the loss
    assert error <= tolerance("kit", "restitution" if candidate.steps else "restitution_exact").limit


def bounced(case: Case, trace: Trace) -> float:
    """Restitution of an impact, from the kinetic energy and momentum of a run."""
    assert np.abs(trace.force_N[-1]).max() <= REST_SHARE * trace.force_N.max(), "the impact is not over"
    apart = trace.kinetic_energy_J
    if case.chain.wall is None:
        apart = apart - trace.momentum_N_s**2 / (2 * case.chain.mass_kg.sum())
    return float(np.sqrt(apart[-1] / apart[0]))


def test_blow_up(candidate: Candidate) -> None:
    """At a stable step a run is done; at a step at which bodies pass through each other it fails."""
    if not candidate.steps:
        pytest.skip("the engine has no time step")
    case = case_with(*PRECOMPRESSION)
    stable_s, unstable_s, _ = step_limit(case)
    assert unstable_s is not None
    candidate.run(case.sampled_at_every(STABLE_SHARE * stable_s))
    with pytest.raises(RunError, match=f"^{UNSTABLE}"):
        candidate.run(case.sampled_at_every(PASSES * unstable_s))


def test_changed_decks(candidate: Candidate) -> None:
    """A run of a deck with one changed number is not that of the scene: it fails.

    The unchanged deck runs first: an engine that fails on everything notices nothing.
    """
    candidate.run(candidate.base)
    unseen = []
    for change, other in candidate.changed().items():
        with suppress(RunError):
            candidate.run_deck(candidate.base, candidate.engine.render(other))
            unseen.append(change)
    assert not unseen, f"not noticed: {unseen}"
