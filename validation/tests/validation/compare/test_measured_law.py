"""Measured laws of motions with one fault, made in memory."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.schemes import verlet_in_heights, verlet_of
from drivers.chain.trace import Trace, make_trace, until
from validation.accuracy import measured_law as law
from validation.accuracy.measured_law import measure_law
from validation.compare.law_sentence import SAME, law_sentence
from validation.stability.measured_limits import random_case
from validation.tests.helpers.scenes import case_of


def changed(case: Case, **arrays: Any) -> Trace:
    return verlet_in_heights(replace(case, chain=replace(case.chain, **arrays)))


def one(values: Array, place: int, factor: float) -> Array:
    return np.where(np.arange(len(values)) == place, factor * values, values)


@pytest.mark.parametrize("number", range(3))
def test_one_fault_in_a_random_scene_is_measured(number: int) -> None:
    case, draw = random_case(number, accuracy=1e-4), np.random.default_rng(number)
    chain, step_s = case.chain, case.scene.time_step_s
    closed = [row.place for row in measure_law(case, verlet_in_heights(case), step_s) if row.quantity == law.STIFFNESS]
    place = int(draw.choice(closed))
    factor = float(draw.choice([0.5, 0.9, 1 + 1e-6, 1.1, 2.0]))
    rows = measure_law(case, changed(case, stiffness=one(chain.stiffness, place - 1, factor)), step_s)
    measured = {row.place: row for row in rows if row.quantity == law.STIFFNESS}
    assert measured[place].ratio == pytest.approx(factor, abs=1e-7)
    assert {row.place for row in measured.values() if row.differs} == {place}
    slower = changed(case, velocity_m_s=0.7 * chain.velocity_m_s)
    speeds = [row.ratio for row in measure_law(case, slower, step_s) if row.quantity == law.START_SPEED]
    assert speeds == pytest.approx([0.7] * len(speeds))
    masses = measure_law(case, changed(case, mass_kg=1.3 * chain.mass_kg), step_s)
    heavy = [row for row in masses if row.quantity == law.MASS]
    assert all(abs(row.ratio - 1.3) <= law.SIGNIFICANCE * row.uncertainty + 1e-3 for row in heavy)
    assert any(abs(row.ratio - 1.3) < 1e-2 for row in heavy)


def half_a_step_late(case: Case, trace: Trace) -> Trace:
    """Trace with velocities recorded half a time step before heights and forces."""
    assert trace.height_m is not None
    assert trace.velocity_m_s is not None
    above = np.column_stack([trace.force_N[:, 1:], np.zeros(len(trace.force_N))])
    acceleration = (trace.force_N - above + case.chain.load_N) / case.chain.mass_kg
    velocity = trace.velocity_m_s - case.scene.time_step_s / 2 * acceleration
    return make_trace(case.chain, trace.time_s, trace.force_N, trace.height_m, velocity)


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        ("stiffness", "all contacts 1.0001 times as stiff"),
        ("overlap", "bodies start just touching, not in equilibrium"),
        ("late", "recorded velocities are half a step (0.05 µs) late"),
        ("nothing", SAME),
        ("step", f"{SAME}; the error is 4.01 times the scheme's, as at a time step of 0.2 µs"),
    ],
)
def test_a_fault_is_said_in_one_line(fault: str, sentence: str) -> None:
    case = case_of("fig4")
    chain = case.chain
    touching = replace(chain, overlap_m=0 * chain.overlap_m)
    trace = {
        "stiffness": lambda: changed(case, stiffness=1.0001 * chain.stiffness),
        "overlap": lambda: verlet_in_heights(replace(case, chain=touching)),
        "late": lambda: half_a_step_late(case, verlet_of(case)),
        "nothing": lambda: verlet_of(case),
        "step": lambda: verlet_of(case.at(5)),
    }[fault]()
    assert law_sentence(case, "yade", trace) == sentence


def test_reasons_for_no_law() -> None:
    tube, case = case_of("fig4-tube", "run.duration=20 us"), case_of("fig4")
    trace = verlet_of(case)
    for measured, given, words in (
        (tube, verlet_of(tube), "only straight chains are measured"),
        (case, until(trace, 5), "only 5 samples, 12 are needed"),
        (case, replace(trace, height_m=None), "no heights and velocities were recorded"),
    ):
        assert law_sentence(measured, "yade", given) == f"law not measured: {words}"
