"""Diagnoses of motions with one fault, made in memory."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.schemes import verlet_in_heights, verlet_of
from drivers.chain.trace import Trace, until
from validation.compare.diagnosis import diagnosis, own_ratios
from validation.tests.helpers.random_chains import random_case
from validation.tests.helpers.scenes import case_of

SMALL = ("chain.count=12", "run.duration=0.4 ms")


def changed(case: Case, **arrays: Any) -> Trace:
    return verlet_in_heights(replace(case, chain=replace(case.chain, **arrays)))


def one(values: Array, place: int, factor: float) -> Array:
    return np.where(np.arange(len(values)) == place, factor * values, values)


@pytest.mark.parametrize("number", range(3))
def test_ratios_are_those_of_the_motion_itself(number: int) -> None:
    case, draw = random_case(number, accuracy=1e-4), np.random.default_rng(number)
    right = own_ratios(case, verlet_in_heights(case))
    assert max(np.abs(np.subtract(right, 1)).max(axis=1)) < 1e-3
    place, factor = int(draw.integers(case.chain.bodies)), float(draw.choice([0.5, 0.9, 1.1, 2.0]))
    stiffness, _ = own_ratios(case, changed(case, stiffness=one(case.chain.stiffness, place, factor)))
    assert int(np.argmax(np.abs(stiffness - 1))) == place
    assert stiffness[place] == pytest.approx(factor, abs=1e-7)


@pytest.mark.long
@pytest.mark.parametrize("settings", [(), ("chain.precompression=10 N", "striker.speed=1 cm/s")])
def test_one_change_is_found_however_small(settings: tuple[str, ...]) -> None:
    case = case_of("fig4", *SMALL, *settings)
    chain, step_us = case.chain, 1e6 * case.scene.time_step_s
    for trace, words in (
        (changed(case, stiffness=1.0001 * chain.stiffness), r"Young's modulus of ptfe|all contacts 1\.0001 times"),
        (changed(case, stiffness=one(chain.stiffness, 8, 1.00001)), r"contact 9 1\.00001 times as stiff"),
        (changed(case, velocity_m_s=0.99 * chain.velocity_m_s), r"start speeds 0\.99 times"),
        (
            verlet_of(case_of("fig4", *SMALL, *settings, "contact.damping_ratio=1e-4")),
            r"a damping ratio of (0\.0001|9\.99999\d*e-05)\b",
        ),
        (
            verlet_of(case_of("fig4", *SMALL, *settings, f"run.time_step={step_us / 2} us")),
            "no single change|a time step",
        ),
    ):
        assert re.search(words, diagnosis(case, "lammps", trace)[1]), words
    weightless = case_of("fig4", *SMALL, *settings, "gravity=0 m/s^2")
    trace = changed(weightless, mass_kg=one(chain.mass_kg, 7, 1.00001))
    assert diagnosis(weightless, "lammps", trace)[1] == "bead 8 with 1.00001 of its mass"


def test_two_changes_are_not_explained_by_one() -> None:
    case = case_of("fig4")
    stiffer = one(case.chain.stiffness, 4, 1.1)
    trace = changed(case, stiffness=stiffer, mass_kg=one(case.chain.mass_kg, 12, 1.1))
    _, said = diagnosis(case, "lammps", trace)
    assert said.startswith("no single change explains it; largest: ")
    assert {*said.partition("largest: ")[2].split(", ")} >= {"stiffness of contact 5 1.1", "mass of bead 13 1.1"}


def test_reasons_for_no_diagnosis() -> None:
    tube, case = case_of("fig4-tube", "run.duration=20 us"), case_of("fig4")
    blind = replace(changed(case, mass_kg=1.1 * case.chain.mass_kg), height_m=None)
    assert not np.subtract(own_ratios(case, blind), 1).any()
    assert diagnosis(case, "yade", verlet_of(case)) == ("", "")
    why = ("in three dimensions", "with 5 samples and 176000 bodies times steps")
    for each, wrong, said in ((tube, verlet_of(tube), why[0]), (case, until(blind, 5), why[1])):
        wrong = replace(wrong, force_N=1.1 * wrong.force_N)
        assert diagnosis(each, "yade", wrong)[1] == f"no cause sought {said}"
