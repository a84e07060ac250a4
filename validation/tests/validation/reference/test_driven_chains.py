"""Driven chains in the in-repo integrators, against an independent solution of their equations."""

from functools import partial

import numpy as np
import pytest

from validation.reference.adaptive import integrate_adaptive
from validation.reference.hertz_chain import COLUMNS, Array, Drive, HertzChain
from validation.reference.velocity_verlet import integrate_verlet
from validation.tests.helpers.by_scipy import forces_at

BODIES, FORCE_N, STIFFNESS, MASS_KG = 6, 10.0, 4e9, 1e-3
TIMES_S: Array = np.arange(151, dtype=float) * 2e-6
TURN, GROWTH = 2 * np.pi * 9e3, 1.5e8
KINKS_S = (0.0, 1.8e-5, 1.11e-4, 2.31e-4)  # the last two are not sample times


def wave(time_s: float, amplitude: float) -> float:
    """Sine of growing frequency between the first kinks, then a ramp back to 0."""
    since = min(max(time_s, KINKS_S[1]), KINKS_S[2]) - KINKS_S[1]
    left = min(max((KINKS_S[3] - time_s) / (KINKS_S[3] - KINKS_S[2]), 0.0), 1.0)
    return float(left * amplitude * np.sin(TURN * since + GROWTH * since**2))


def slope(time_s: float, amplitude: float) -> float:
    """Rate of the wave; at a kink that after it."""
    since = time_s - KINKS_S[1]
    if KINKS_S[1] <= time_s < KINKS_S[2]:
        return float(amplitude * (TURN + 2 * GROWTH * since) * np.cos(TURN * since + GROWTH * since**2))
    return -wave(KINKS_S[2], amplitude) / (KINKS_S[3] - KINKS_S[2]) if KINKS_S[2] <= time_s < KINKS_S[3] else 0.0


def driven(body: int, amplitude: float, *, prescribed: bool, damping: float = 0.0) -> HertzChain:
    """Pressed chain with the wave as the force on a body, or as its motion."""
    rows = np.zeros((4, COLUMNS))
    rows[:, 0] = KINKS_S
    rows[1, 3:7] = amplitude, 0.0, TURN, 2 * GROWTH
    rows[2, 1] = wave(KINKS_S[2], amplitude)
    rows[2, 2] = -rows[2, 1] / (KINKS_S[3] - KINKS_S[2])
    ones, load = np.ones(BODIES), -FORCE_N * np.eye(BODIES)[-1]
    overlap = (FORCE_N / STIFFNESS) ** (2 / 3) * ones
    drive = Drive(body, prescribed, rows)
    return HertzChain(MASS_KG * ones, STIFFNESS * ones, overlap, 0 * ones, load, damping * ones, drive=drive)


@pytest.mark.parametrize(
    ("body", "prescribed", "amplitude", "damping", "within"),
    [
        (5, False, -3.0, 60.0, 1e-9),
        (0, False, 5.0, 0.0, 1e-9),
        (2, True, -4e-7, 0.0, 1e-9),
        (2, True, -4e-7, 60.0, 1e-7),
    ],
)
def test_the_reference_agrees_with_scipy_across_kinks(
    body: int, prescribed: bool, amplitude: float, damping: float, within: float
) -> None:
    chain = driven(body, amplitude, prescribed=prescribed, damping=damping)
    expected = forces_at(chain, TIMES_S, partial(slope if prescribed else wave, amplitude=amplitude))
    change = np.abs(expected - expected[0]).max()
    assert change > 1
    assert np.abs(integrate_adaptive(chain, TIMES_S, 1e-11).force_N - expected).max() < within * change


@pytest.mark.parametrize(("amplitude", "prescribed"), [(-3.0, False), (-4e-7, True)])
def test_verlet_drives_with_second_order(amplitude: float, prescribed: bool) -> None:
    chain = driven(3, amplitude, prescribed=prescribed)
    exact = integrate_adaptive(chain, TIMES_S).force_N
    coarse, fine = (np.abs(integrate_verlet(chain, 2e-6 / n, n, 151).force_N - exact).max() for n in (40, 80))
    assert np.log2(coarse / fine) == pytest.approx(2, abs=0.1)


def test_wrong_tables_of_segments_are_named() -> None:
    for shape, value in (((0, COLUMNS), 0.0), ((1, 3), 0.0), ((1, COLUMNS), np.nan), ((2, COLUMNS), 0.0)):
        with pytest.raises(ValueError, match="segments: "):
            Drive(0, False, np.full(shape, value))
