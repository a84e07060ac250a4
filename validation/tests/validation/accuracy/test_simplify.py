"""What an accuracy lets out: little enough, all that may go, and nothing else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.chain.case import Case
from drivers.chain.chain import build_chain
from drivers.engines import load_engine
from postproc.read.residual import residual
from validation.accuracy.plan import asked_of
from validation.accuracy.schemes import errors_of, truth_of, verlet_of
from validation.accuracy.step_choice import SHARE, WITHOUT, simplify
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import case_of

ASKED = [
    ("fig4", "1e-2"),
    ("fig4", "0.3"),
    ("fig4", "{ wall_peak = 1e-2, bead_5_arrival = 1e-2 }"),
    ("low-amplitude", "{ wall_peak = 1e-2 }"),
    ("fig5", "1e-3"),
]
RICH = ("chain.precompression=0.01 mN", "chain.mass_scatter=0.001 mg", "contact.restitution=0.9999", "seed=3")


def asking(scene: str, accuracy: str, *settings: str) -> Case:
    return case_of(scene, "run.time_step=", f"run.accuracy={accuracy}", *settings)


def left_out(case: Case) -> list[str]:
    return [each.name for each in case.elements if each.reason.startswith("left out (")]


@pytest.mark.parametrize(("scene", "accuracy"), ASKED)
@pytest.mark.parametrize("settings", [(), RICH], ids=["as shipped", "rich"])
def test_what_is_left_out_changes_too_little(scene: str, accuracy: str, settings: tuple[str, ...]) -> None:
    case = asking(scene, accuracy, *settings)
    left, asked = left_out(case), asked_of(case)
    if case.full is None:
        assert not left
        return
    assert left
    truth, without = truth_of(case.full), truth_of(case, finer=False)
    together = errors_of(case.full, without.trace, truth, asked)
    assert all(together[name] <= SHARE * share for name, share in asked.items())
    for element in case.elements:
        if element.name not in left:
            continue
        assert not element.modelled
        changed = WITHOUT[element.name](case.full.scene)
        assert changed != case.full.scene
        alone = errors_of(case.full, truth_of(_of(case.full, element.name), finer=False).trace, truth, asked)
        worst = max(asked, key=lambda name: alone[name] / asked[name])
        assert f"it changes the {worst} by {alone[worst]:.1e}, where {asked[worst]:g} is asked for" in element.reason
    # what is left of the accuracy is enough for the step
    whole = errors_of(case.full, verlet_of(case), truth, asked)
    assert all(whole[name] <= share for name, share in asked.items())


def _of(case: Case, name: str) -> Case:
    """The case without one element, built anew from its scene."""
    scene = WITHOUT[name](case.scene)
    return replace(case, scene=scene, chain=build_chain(scene))


def test_all_that_may_go_goes() -> None:
    case = asking("fig4", "1e-2", *RICH)
    kept = [each.name for each in case.elements if each.modelled and each.name in WITHOUT]
    assert case.full is not None
    truth = truth_of(case.full, finer=False)
    for name in kept:
        further = residual(truth_of(_of(case, name), finer=False).trace, truth.trace).max()
        assert further > SHARE * 1e-2, f"{name} could have gone"
    assert left_out(case)


# what a deck has with a precompression and with damping
WORDS = {
    "liggghts": {"precompression": "addforce", "damping": "limitForce"},
    "yade": {"precompression": "setPermF", "damping": "betan"},
}


@pytest.mark.parametrize("engine", ["liggghts", "yade"])
def test_a_deck_has_no_line_of_what_is_left_out(engine: str, shared_runs: Path) -> None:
    case = asking("fig4", "1e-2", *RICH)
    assert left_out(case) == ["precompression", "mass scatter", "damping"]
    assert case.full is not None
    assert len(set(case.full.chain.mass_kg)) > 20
    assert set(case.chain.mass_kg) == {0.1226e-3, 0.116e-3}
    for name, word in WORDS[engine].items():
        assert case.full.models(name)
        assert not case.models(name)
        whole, deck = ("".join(load_engine(engine).render(each).files.values()) for each in (case.full, case))
        assert word in whole
        assert word not in deck
    run = finished(case, engine, shared_runs)
    assert float(residual(run.trace, truth_of(case.full, finer=False).trace).max()) <= 1e-2
    stored = next(each for each in run.record.elements if each["name"] == "precompression")
    assert stored["modelled"] is False
    assert stored["reason"].startswith("left out (1e-05 N on the top bead): it changes the force by ")


@pytest.mark.parametrize("accuracy", ["1e-6", "{ wall_peak = 1e-6 }", "{ force = 1e-2, bead_5_arrival = 1e-6 }"])
def test_nothing_goes_where_all_is_needed(accuracy: str) -> None:
    case = asking("fig4", accuracy)
    assert case.full is None
    assert case.elements == case_of("fig4").elements
    assert np.array_equal(case.chain.load_N, case_of("fig4").chain.load_N)


def test_without_candidates_nothing_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*_: object, **__: object) -> None:
        pytest.fail("followed a motion")

    monkeypatch.setattr("validation.accuracy.step_choice.truth_of", never)
    bare = case_of("fig4", "gravity=", "chain.sensors=[]")
    assert simplify(bare, {"force": 0.5}) is bare


def test_a_quantity_that_is_not_shown_lets_nothing_out() -> None:
    case = case_of("fig4", 'run.duration="20 us"')
    assert simplify(case, {"wall_peak": 0.9}) is case


def test_effects_that_cannot_be_measured_let_nothing_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ArithmeticError("no step is small enough")

    monkeypatch.setattr("validation.accuracy.step_choice.truth_of", fails)
    case = case_of("fig4")
    assert simplify(case, {"force": 0.9}) is case
