"""Elements left out for an accuracy: of negligible effect, as many as possible, and no others."""

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.chain.case import Case
from drivers.chain.chain import build_chain
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import residual
from drivers.engines import load_engine
from validation.accuracy.motions import errors_of, exact_motion_of
from validation.accuracy.plan import ELEMENTS_SHARE, REMOVALS, simplify
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import case_of

RICH = ("chain.precompression=0.01 mN", "chain.mass_scatter=0.001 mg", "contact.restitution=0.9999", "seed=3")


def asking(scene: str, accuracy: str, *settings: str) -> Case:
    return case_of(scene, "run.time_step=", f"run.accuracy={accuracy}", *settings)


def left_out(case: Case) -> list[str]:
    return [each.name for each in case.elements if each.reason.startswith("left out (")]


@pytest.mark.parametrize(
    ("scene", "accuracy", "settings"),
    [
        ("fig4", "{ wall_peak = 1e-2, bead_5_arrival = 1e-2 }", RICH),
        ("low-amplitude", "{ wall_peak = 1e-2 }", ()),
        ("fig4", "1e-2", RICH),
    ],
)
def test_elements_of_negligible_effect_alone_are_left_out(scene: str, accuracy: str, settings: tuple[str, ...]) -> None:
    case = asking(scene, accuracy, *settings)
    assert case.plan is not None
    left, asked = left_out(case), case.plan.asked
    assert left
    assert case.full is not None
    kept = [element.name for element in case.elements if element.modelled and element.name in REMOVALS]
    truth, without = exact_motion_of(case.full), exact_motion_of(case, finer=False)
    together = errors_of(case.full, without.trace, truth, asked)
    assert all(together[name] <= ELEMENTS_SHARE * share for name, share in asked.items())
    for element in case.elements:
        if element.name in left:
            assert not element.modelled
            other = exact_motion_of(_of(case.full, element.name), finer=False).trace
            alone = errors_of(case.full, other, truth, asked)
            worst = max(asked, key=lambda name: alone[name] / asked[name])
            change = f"it changes the {worst} by {alone[worst]:.1e}; the requested accuracy is {asked[worst]:g}"
            assert change in element.reason
    for name in kept:
        further = errors_of(case.full, exact_motion_of(_of(case, name), finer=False).trace, truth, asked)
        assert any(further[name] > ELEMENTS_SHARE * share for name, share in asked.items()), f"{name} is negligible"
    # the rest of the accuracy is enough for the step
    whole = errors_of(case.full, verlet_of(case), truth, asked)
    assert all(whole[name] <= share for name, share in asked.items())


def _of(case: Case, name: str) -> Case:
    """Case without one element, built again from its scene."""
    scene = REMOVALS[name](case.scene)
    return replace(case, scene=scene, chain=build_chain(scene))


def test_a_deck_has_no_line_of_an_element_left_out(shared_runs: Path) -> None:
    case = asking("fig4", "1e-2", *RICH)
    assert left_out(case) == ["precompression", "mass scatter", "damping"]
    assert case.full is not None
    assert len(set(case.full.chain.mass_kg)) > 20
    assert set(case.chain.mass_kg) == {0.1226e-3, 0.116e-3}
    whole, deck = ("".join(load_engine("liggghts").render(each).files.values()) for each in (case.full, case))
    for name, word in (("precompression", "addforce"), ("damping", "limitForce")):
        assert name in case.full.reasons
        assert name not in case.reasons
        assert word in whole
        assert word not in deck
    run = finished(case, "liggghts", shared_runs)
    assert float(residual(run.trace, exact_motion_of(case.full, finer=False).trace).max()) <= 1e-2
    stored = next(each for each in run.record.elements if each["name"] == "precompression")
    assert stored["modelled"] is False
    assert stored["reason"].startswith("left out (1e-05 N on the top bead): it changes the force by ")


@pytest.mark.parametrize("accuracy", ["1e-6", "{ force = 1e-2, bead_5_arrival = 1e-6 }"])
def test_no_element_is_left_out_if_all_matter(accuracy: str) -> None:
    case = asking("fig4", accuracy)
    assert case.full is None
    assert case.elements == case_of("fig4").elements


def test_no_element_is_left_out_if_effects_cannot_be_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    missing = case_of("fig4", 'run.duration="20 us"')
    assert simplify(missing, {"wall_peak": 0.9}) is missing

    def fails(*_: object, **__: object) -> None:
        raise ArithmeticError("no step is small enough")

    monkeypatch.setattr("validation.accuracy.plan.exact_motion_of", fails)
    case = case_of("fig4")
    assert simplify(case, {"force": 0.9}) is case
