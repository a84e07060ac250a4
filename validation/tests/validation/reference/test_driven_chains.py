"""Driven chains in the in-repo integrators, against independent solutions of their equations."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from validation.reference.adaptive import integrate_adaptive
from validation.reference.hertz_chain import COLUMNS, Array, Drive, HertzChain
from validation.reference.velocity_verlet import integrate_verlet

BODIES, FORCE_N, STIFFNESS, MASS_KG = 6, 10.0, 4e9, 1e-3
TIMES_S: Array = np.arange(151, dtype=float) * 2e-6
TURN = 2 * np.pi * 9e3
KINKS_S = (0.0, 1.8e-5, 1.11e-4, 2.31e-4)  # the last two are not sample times


def drive(body: int, *, prescribed: bool, amplitude: float) -> Drive:
    """Drive by a sine of growing frequency, then a ramp back to 0."""
    rows = np.zeros((4, COLUMNS))
    rows[:, 0] = KINKS_S
    rows[1, 3:7] = amplitude, 0.0, TURN, 3e8
    tau = KINKS_S[2] - KINKS_S[1]
    rows[2, 1] = amplitude * np.sin(TURN * tau + 1.5e8 * tau**2)
    rows[2, 2] = -rows[2, 1] / (KINKS_S[3] - KINKS_S[2])
    return Drive(body, prescribed, rows)


def chain(body: int, *, prescribed: bool, amplitude: float, damping: float = 0.0) -> HertzChain:
    ones, load = np.ones(BODIES), np.zeros(BODIES)
    load[-1] = -FORCE_N
    overlap = (FORCE_N / STIFFNESS) ** (2 / 3) * ones
    driven = drive(body, prescribed=prescribed, amplitude=amplitude)
    return HertzChain(MASS_KG * ones, STIFFNESS * ones, overlap, 0 * ones, load, damping * ones, drive=driven)


def independent_forces(case: HertzChain) -> Array:
    """Contact forces by scipy, in positions, restarted at each kink; the wave form is written out a second time."""
    found = case.drive
    assert found is not None
    body, amplitude = found.body, float(found.segments[1, 3])
    back = float(found.segments[2, 1])

    def value(time: float, piece: int) -> Any:
        if piece == 1:
            return amplitude * np.sin(TURN * (time - KINKS_S[1]) + 1.5e8 * (time - KINKS_S[1]) ** 2)
        return back * (KINKS_S[3] - time) / (KINKS_S[3] - KINKS_S[2]) if piece == 2 else 0.0

    def contacts(place: Array, velocity: Array) -> Array:
        overlap = case.overlap_m - np.diff(place, prepend=0.0)
        closing = -np.diff(velocity, prepend=0.0)
        damped = case.damping * np.maximum(overlap, 0) ** 0.25 * closing
        return np.maximum(case.stiffness * np.maximum(overlap, 0) ** 1.5 + damped, 0)

    def moved(time: float, state: Array, piece: int) -> tuple[Array, Array]:
        place, velocity = state[:BODIES].copy(), state[BODIES:].copy()
        if found.prescribed:
            h = 1e-9
            place[body] = value(time, piece)
            velocity[body] = (value(time + h, piece) - value(time - h, piece)) / (2 * h)
        return place, velocity

    def rate(time: float, state: Array, piece: int) -> Array:
        place, velocity = moved(time, state, piece)
        force = contacts(place, velocity)
        net = force - np.append(force[1:], 0.0) + case.load_N
        net[body] += 0.0 if found.prescribed else value(time, piece)
        return np.concatenate([velocity, net / case.mass_kg])

    forces, state = np.zeros((len(TIMES_S), BODIES)), np.zeros(2 * BODIES)
    for piece, (begin, end) in enumerate(zip(KINKS_S, (*KINKS_S[1:], TIMES_S[-1]), strict=True)):
        inside = (begin <= TIMES_S) & ((end > TIMES_S) | (end == TIMES_S[-1]))
        solved = solve_ivp(
            rate, (begin, end), state, "DOP853", np.union1d(TIMES_S[inside], end), args=(piece,), rtol=1e-12, atol=1e-16
        )
        for sample, column in zip(np.flatnonzero(inside), solved.y.T, strict=False):
            forces[sample] = contacts(*moved(TIMES_S[sample], column, piece))
        state = solved.y[:, -1]
    return forces


@pytest.mark.parametrize("damping", [0.0, 60.0])
@pytest.mark.parametrize(("body", "prescribed", "amplitude"), [(5, False, -3.0), (2, True, -4e-7), (0, False, 5.0)])
def test_the_reference_agrees_with_scipy_across_kinks(
    body: int, prescribed: bool, amplitude: float, damping: float
) -> None:
    case = chain(body, prescribed=prescribed, amplitude=amplitude, damping=damping)
    expected = independent_forces(case)
    change = np.abs(expected - expected[0]).max()
    assert change > 1
    found = integrate_adaptive(case, TIMES_S, 1e-11).force_N
    assert np.abs(found - expected).max() < (1e-7 if prescribed and damping else 1e-9) * change


@pytest.mark.parametrize("prescribed", [False, True])
def test_verlet_is_of_second_order(prescribed: bool) -> None:
    case = chain(3, prescribed=prescribed, amplitude=-4e-7 if prescribed else -3.0)
    exact = integrate_adaptive(case, TIMES_S).force_N
    coarse, fine = (np.abs(integrate_verlet(case, 2e-6 / n, n, 151).force_N - exact).max() for n in (40, 80))
    assert np.log2(coarse / fine) == pytest.approx(2, abs=0.1)


def test_a_further_kink_changes_nothing() -> None:
    case = chain(4, prescribed=True, amplitude=-4e-7)
    assert case.drive is not None
    rows = np.insert(case.drive.segments, 3, case.drive.segments[2], axis=0)
    rows[3, :2] = 1.5e-4, rows[2, 1] + rows[2, 2] * (1.5e-4 - rows[2, 0])
    split = HertzChain(**{**vars(case), "drive": Drive(4, True, rows)})
    one, other = (integrate_adaptive(each, TIMES_S).force_N for each in (case, split))
    assert np.abs(one - other).max() < 1e-11 * FORCE_N


def test_a_weak_drive_has_the_linear_response() -> None:
    """Modes of the linear chain: ``q'' = -w^2 q + f sin(W t)`` from rest, in closed form."""
    amplitude, rows = 1e-6 * FORCE_N, np.zeros((1, COLUMNS))
    rows[0, 3:7] = amplitude, 0.0, TURN, 0.0
    weak = chain(5, prescribed=False, amplitude=1.0)
    weak = HertzChain(**{**vars(weak), "drive": Drive(5, False, rows)})
    spring = 1.5 * STIFFNESS * np.sqrt(weak.overlap_m)
    matrix = np.diag(spring + np.append(spring[1:], 0)) - np.diag(spring[1:], 1) - np.diag(spring[1:], -1)
    squares, shapes = eigh(matrix / MASS_KG)
    own = np.sqrt(squares)
    answer = (np.sin(TURN * TIMES_S[:, None]) - TURN / own * np.sin(own * TIMES_S[:, None])) / (squares - TURN**2)
    displacement = amplitude / MASS_KG * (answer * shapes[5]) @ shapes.T
    expected = -spring * np.diff(displacement, axis=1, prepend=0.0)
    found = integrate_adaptive(weak, TIMES_S).force_N
    assert np.abs(found - found[0] - expected).max() < 2e-6 * np.abs(expected).max()


@pytest.mark.parametrize(
    "rows", [np.zeros((0, COLUMNS)), np.zeros((1, 3)), np.full((1, COLUMNS), np.nan), np.zeros((2, COLUMNS))]
)
def test_wrong_tables_of_segments(rows: Array) -> None:
    with pytest.raises(ValueError, match="segments: "):
        Drive(0, False, rows)
