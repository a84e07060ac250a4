"""In-repo integrators against closed formulas, conservation laws, and 40 digits."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from drivers.base import paths
from drivers.chain.chain import arrays_of
from validation.reference.adaptive import MIN_TOLERANCE, integrate_adaptive
from validation.reference.dop853 import FORMULAS, SLOPES, SPARE, STATES, ZEROS, weigh
from validation.reference.hertz_chain import Array, HertzChain, hertz_force
from validation.reference.symplectic import integrate_symplectic
from validation.reference.travelling_wave import solve_travelling_wave
from validation.reference.velocity_verlet import integrate_verlet
from validation.tests.helpers import high_precision
from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import case_of

MASS_KG, STIFFNESS = 1e-4, 1e6


def struck(count: int, speed: float = 1.0, load_N: float = 0.0) -> HertzChain:
    """Equal bodies, pressed by a load; the top body moves down."""
    one, velocity, load = np.ones(count), np.zeros(count), np.zeros(count)
    velocity[-1], load[-1] = -speed, -load_N
    overlap = (load_N / STIFFNESS) ** (2 / 3)
    return HertzChain(MASS_KG * one, STIFFNESS * one, overlap * one, velocity, load)


def forces_of_symplectic(chain: HertzChain, time_step_s: float, steps: int, samples: int) -> Array:
    return hertz_force(chain.stiffness, integrate_symplectic(chain, time_step_s, steps, samples)[0])


def forces_of_verlet(chain: HertzChain, time_step_s: float, steps: int, samples: int) -> Array:
    return integrate_verlet(chain, time_step_s, steps, samples).force_N


@pytest.mark.parametrize(
    ("forces", "chain", "steps", "order", "within"),
    [
        pytest.param(forces_of_verlet, struck(6), 32, 2.0, 0.05, id="Verlet"),
        pytest.param(forces_of_symplectic, struck(8, 0.02, load_N=1.0), 8, 4.0, 0.2, id="contacts that stay closed"),
        pytest.param(forces_of_symplectic, struck(6), 32, 2.65, 0.65, id="contacts that open"),
    ],
)
def test_errors_fall_by_the_order_of_the_method(
    forces: Callable[[HertzChain, float, int, int], Array],
    chain: HertzChain,
    steps: int,
    order: float,
    within: float,
) -> None:
    exact = integrate_adaptive(chain, np.linspace(0, 4e-4, 41)).force_N
    coarse, fine = (np.abs(forces(chain, 1e-5 / n, n, 41) - exact).max() for n in (steps, 4 * steps))
    assert np.log2(coarse / fine) / 2 == pytest.approx(order, abs=within)


GAPS = "chain.bead=[{from_wall=3, gap_below='20 um'}, {from_wall=5, gap_below='5 um'}]"


@pytest.mark.parametrize(
    "settings",
    [
        pytest.param((), marks=pytest.mark.long, id="fig4"),
        pytest.param(("gravity=", "chain.sensors=[]", "chain.count=5", GAPS), id="beads separate and meet again"),
    ],
)
def test_the_true_error_matches_the_requested_tolerance(settings: tuple[str, ...]) -> None:
    """At most the tolerance, and at least a thousandth of it, so that no time is wasted."""
    chain, times = case_of("fig4", *settings).chain, np.linspace(0, 8e-4, 41)
    exact = np.array(list(high_precision.forces_at(chain, times)))
    for exponent in range(4, 13):
        tolerance = 10.0**-exponent
        error = np.abs(integrate_adaptive(arrays_of(chain), times, tolerance).force_N - exact).max() / exact.max()
        assert 1e-3 * tolerance < error <= tolerance


@pytest.mark.parametrize(("kind", "seed", "bodies"), [("light", 1, 4), ("flat", 0, 6), ("gaps", 0, 3), ("gaps", 1, 3)])
def test_light_beads_flat_strikers_and_damped_gaps_meet_the_tolerance(kind: str, seed: int, bodies: int) -> None:
    chain, times = high_precision.random_chain(kind, seed, bodies)
    exact = np.array(list(high_precision.forces_at(chain, times)))
    for tolerance in (1e-6, 1e-9, MIN_TOLERANCE):
        error = np.abs(integrate_adaptive(chain, times, tolerance).force_N - exact).max() / exact.max()
        assert error <= tolerance


@pytest.mark.long
@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 3e-7, 3e-8, 1e-8])
def test_shipped_scenes_err_by_less_than_asked_for_and_not_much_less(tolerance: float) -> None:
    """At 1e-4 most scenes err by less: their samples are so near that no longer steps are taken."""
    errors = []
    for scene in sorted(paths.SCENES.glob("*.toml")):
        case = case_of(scene.stem)
        if case.chain.straight and case.chain.bodies < 100:
            chain, times = arrays_of(case.chain), case.sample_times_s
            exact, motion = (integrate_adaptive(chain, times, each).force_N for each in (MIN_TOLERANCE, tolerance))
            errors.append(np.abs(motion - exact).max() / exact.max())
    assert len(errors) > 15
    assert max(errors) <= tolerance
    assert np.quantile(errors, 0.9) > tolerance / 30


def test_a_window_of_a_long_chain_moves_with_the_wave() -> None:
    """The wave runs to the wall and back through beads that are at rest, and meets beads that fly.

    With energies all bodies are integrated.
    """
    chain, times = struck(150), np.linspace(0, 1.2e-2, 301)
    for tolerance in (1e-5, 1e-9):
        window, whole = (integrate_adaptive(chain, times, tolerance, energies=energies) for energies in (False, True))
        for name in ("force_N", "velocity_m_s", "displacement_m"):
            one, other = getattr(window, name), getattr(whole, name)
            assert 0 < np.abs(one - other).max() <= tolerance * np.abs(other).max()


def test_the_travelling_wave_has_the_known_constants() -> None:
    wave = solve_travelling_wave()
    assert wave.residual < 1e-15
    assert wave.speed_by_force == pytest.approx(0.905516, abs=5e-7)
    assert wave.speed_by_velocity == pytest.approx(0.907470, abs=5e-7)
    assert wave.force_by_velocity == pytest.approx(1.013019, abs=5e-7)
    assert wave.momentum_by_velocity == pytest.approx(1.669971, abs=5e-7)
    assert wave.energy_by_velocity == pytest.approx(1.069323, abs=5e-7)
    assert wave.kinetic_share == pytest.approx(5 / 9, abs=1e-12)
    assert [round(wave.width(x, averaged=True), 3) for x in (0.002, 0.04, 0.5)] == [4.989, 3.839, 2.069]
    assert [round(wave.width(x, averaged=False), 3) for x in (0.002, 0.04, 0.5)] == [4.098, 2.998, 1.412]
    done = beads("wave")
    assert done.returncode == 0
    assert "0.9055157764 k^(1/3)" in done.stdout
    assert "4.989445 at 0.002" in done.stdout


def test_slopes_without_weight_are_ignored_even_if_not_finite() -> None:
    """A step that overflows leaves slopes that are not finite; the step is repeated with a smaller size."""
    slopes = np.random.default_rng(1).normal(size=(SLOPES, 7))
    for formula, weights in enumerate(FORMULAS):
        if weights.any():
            rows = np.zeros((STATES, 7))
            rows[:SLOPES] = np.where(weights[:, np.newaxis] == 0, np.nan, slopes)
            weigh(rows, 7, formula, 0.5, ZEROS, SPARE)
            np.testing.assert_allclose(rows[SPARE], 0.5 * weights @ slopes, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"mass_kg": [1.0]}, "stiffness"),
        ({"mass_kg": [1.0, 0.0]}, "mass_kg"),
        ({"stiffness": [1.0, -1.0]}, "stiffness"),
        ({"load_N": [np.nan, 0.0]}, "load_N"),
        ({"velocity_m_s": [[1.0, 0.0]]}, "velocity_m_s"),
        ({"alpha": 0.5}, "alpha"),
        ({"alpha": 1.75, "damping": [1.0, 0.0]}, "damping"),
    ],
)
def test_wrong_arrays_are_named(change: dict[str, Array], named: str) -> None:
    names = ("mass_kg", "stiffness", "overlap_m", "velocity_m_s", "load_N")
    arrays: dict[str, Any] = {name: np.array([1.0, 1.0]) for name in names}
    with pytest.raises(ValueError, match=named):
        HertzChain(**arrays | change)


def test_wrong_times_and_tolerances_are_named() -> None:
    chain, times = struck(2), np.array([0.0, 1e-6])
    for tolerance in (1e-13, 1.0, np.nan):
        with pytest.raises(ValueError, match="1e-12"):
            integrate_adaptive(chain, times, tolerance)
    with pytest.raises(ValueError, match="time_s"):
        integrate_adaptive(chain, times[::-1])
    with pytest.raises(ValueError, match="time_step_s"):
        integrate_verlet(chain, 0.0, 1, 10)
