"""Results of an engine: scenes, order of convergence, restitution, blow-up, changed decks."""

from math import log2
from typing import Any

import numpy as np
import pytest
from drivers.limits.trial import first_failure_s

from drivers.base.errors import RunError
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.residual import FORCE, residual
from drivers.chain.trace import Trace
from drivers.limits.refusal import inability
from drivers.limits.stable_step import predicted_limit
from drivers.run.guard import UNSTABLE
from validation.accuracy.budget import MODEL, budget_of
from validation.accuracy.exact_motion import exact_motion_of
from validation.accuracy.motions import Motions, motions_of
from validation.checks import FAIL, table
from validation.tests.engine.candidate import Candidate, case_of_variant, case_with, kit

STABLE_SHARE = 0.98  # of the predicted limit: a step at which a run has to be stable
PRECOMPRESSION = ("chain.precompression=20 N", "run.duration=1 ms")  # closed contacts make the limit sharp
COLLISION = ("gravity=", "tube=", "run.duration=0.4 ms", "run.time_step=0.02 us")
IMPACTS = {"two beads": (*COLLISION, "chain.count=1", "wall="), "a bead on the wall": (*COLLISION, "chain.count=0")}
LAWS = {"elastic": (), "damped": ("contact.restitution=0.9",)}
RESTITUTIONS = (0.3, 0.8, 0.99)
STEPS = (5, 10, 20)  # steps per sample for the order of convergence


@pytest.mark.parametrize("variant", kit()["variant"], ids=lambda variant: variant["name"].replace(" ", "-"))
def test_scene(candidate: Candidate, variant: dict[str, Any]) -> None:
    """Forces, energy and momentum are those of the engine's scheme."""
    case = case_of_variant(variant)
    checks = budget_of(case, candidate.engine.name, candidate.run(case)).checks
    wrong = [check for check in checks if check.verdict == FAIL and check.quantity.startswith(MODEL)]
    assert wrong == [], "\n".join(table(wrong))


@pytest.mark.parametrize("law", LAWS)
def test_order(candidate: Candidate, law: str) -> None:
    """Errors converge with the order of the scheme: two, or one with damping."""
    if not candidate.steps:
        pytest.skip("the engine has no time step")
    case = case_with(*LAWS[law])
    exact = exact_motion_of(case, finer=False).trace
    errors = [float(residual(candidate.run(case.at(steps)), exact).max()) for steps in STEPS]
    order, expected = log2(errors[1] / errors[2]), Motions(case, candidate.engine.shear).order
    assert order == pytest.approx(expected, abs=tolerance("kit", "order").limit), errors


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
    assert not trace.force_N[-1].any(), "the impact is not over"
    apart = trace.kinetic_energy_J
    if case.chain.wall is None:
        apart = apart - trace.momentum_N_s**2 / (2 * case.chain.mass_kg.sum())
    return float(np.sqrt(apart[-1] / apart[0]))


def test_blow_up(candidate: Candidate) -> None:
    """Below the predicted stability limit a run is stable; at the step where Verlet blows up the run fails."""
    if not candidate.steps:
        pytest.skip("the engine has no time step")
    case = case_with(*PRECOMPRESSION)
    predicted_s = predicted_limit(case.chain, float(case.sample_times_s[-1]))
    candidate.run(case.sampled_at_every(STABLE_SHARE * predicted_s))
    fails_s = first_failure_s(case, predicted_s)
    assert fails_s is not None
    with pytest.raises(RunError, match=f"^{UNSTABLE}"):
        candidate.run(case.sampled_at_every(fails_s))


def test_changed_decks(candidate: Candidate) -> None:
    """The output of a deck with one changed number differs from that of the scene by more than the tolerance.

    The unchanged deck runs first: an engine that fails on everything notices nothing.
    """
    case, name = candidate.base, candidate.engine.name
    motions = motions_of(case, name)
    right, limits = motions.scheme_of(name), motions.explained(FORCE)
    assert (residual(candidate.run(case), right) <= limits).all()
    unseen = {}
    for change, other in candidate.changed().items():
        if inability(other, name) is None:
            try:
                share = float(residual(candidate.run_deck(case, candidate.engine.render(other)), right).max())
            except RunError:  # the guard notices it
                continue
            if not share > limits.max():
                unseen[change] = share
    assert not unseen, f"not noticed: {unseen}"
