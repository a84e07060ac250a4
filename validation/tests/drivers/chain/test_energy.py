"""Energy and momentum: exact to rounding however large the static load, conserved in random scenes."""

from decimal import Decimal, localcontext

import numpy as np
import pytest

from drivers.chain.chain import Array, Chain
from drivers.chain.schemes import exact_of, verlet_in_heights, verlet_of
from drivers.chain.trace import Trace, energy_error_J, potential_energy_change
from drivers.engines import codes
from drivers.run.compute import compute
from drivers.run.guard import energy_error
from validation.accuracy.budget import budget_of
from validation.accuracy.exact_motion import exact_motion_of
from validation.checks import FAIL
from validation.tests.helpers.adversarial import KINDS, adversarial_case
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import case_of

PRESSED = ("chain.precompression=10 N", "chain.sensors=[]", "run.time_step=1 us")
DIGITS = 40


def exact_change(chain: Chain, displacement_m: Array) -> float:
    """Change of the potential energy of one sample in 40 digits, from its definition."""
    with localcontext() as context:
        context.prec = DIGITS
        total, below = Decimal(0), Decimal(0)
        columns = (chain.overlap_m, chain.stiffness, chain.load_N, displacement_m)
        for start, stiffness, load, moved in zip(*([Decimal(float(x)) for x in each] for each in columns), strict=True):
            pressed = [max(overlap, Decimal(0)) for overlap in (start + below - moved, start)]
            energies = [overlap**2 * overlap.sqrt() for overlap in pressed]
            total += Decimal(2) / 5 * stiffness * (energies[0] - energies[1]) - load * moved
            below = moved
        return float(total)


@pytest.mark.parametrize("kind", KINDS)
def test_the_potential_energy_is_its_definition(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """In one part, and in parts of two samples."""
    for number in range(5):
        chain = adversarial_case(kind, number).chain
        monkeypatch.setattr("drivers.chain.trace.CACHED_VALUES", 100_000 if number else 2 * chain.bodies)
        draw = np.random.default_rng(number)
        size_m = np.abs(chain.overlap_m).max() * 10 ** draw.uniform(-9, 1)
        moved = size_m * draw.standard_normal((5, chain.bodies))
        change = -np.diff(moved, axis=1, prepend=0.0)
        terms = np.abs(chain.load_N * moved).sum(axis=1) + (chain.stiffness * np.abs(change) ** 2.5).sum(axis=1)
        exact = [exact_change(chain, row) for row in moved]
        assert np.abs(potential_energy_change(chain, moved) - exact).max() <= 1e-13 * terms.max()


def drift(trace: Trace) -> float:
    return float(np.abs(trace.total_energy_J - trace.total_energy_J[0]).max() / trace.kinetic_energy_J.max())


@pytest.mark.parametrize("speed", ["1e-7 m/s", "1e-4 m/s", "1 m/s"])
@pytest.mark.parametrize("settings", [("gravity=",), ("chain.count=3", "chain.precompression=1 mN")])
def test_no_static_load_hides_the_energy_of_a_weak_wave(settings: tuple[str, ...], speed: str) -> None:
    weak = (*PRESSED, *settings, f"striker.speed={speed}")
    case, damped = case_of("fig4", *weak), case_of("fig4", *weak, "contact.damping_ratio=0.01")
    assert drift(exact_of(case)) < 1e-6
    coarse = drift(verlet_of(case))
    assert coarse < 1e-2
    assert drift(verlet_of(case, finer=4)) == pytest.approx(coarse / 16, rel=0.1, abs=1e-8)  # truncation, no rounding
    assert drift(verlet_in_heights(case)) == pytest.approx(coarse, rel=0.01, abs=2e-4)
    trace = exact_of(damped)
    gained_J = energy_error_J(trace.total_energy_J, damped=True, slips=False).max()
    assert gained_J < 1e-6 * trace.kinetic_energy_J.max()
    assert trace.total_energy_J[0] - trace.total_energy_J[-1] > 1e-3 * trace.kinetic_energy_J.max()


@pytest.mark.parametrize("kind", KINDS)
def test_random_scenes_conserve_energy_and_momentum(kind: str) -> None:
    for number in range(4):
        chain, trace = (case := adversarial_case(kind, number)).chain, exact_motion_of(case, finer=False).trace
        assert energy_error(chain, trace).max() < 1e-9
        if chain.wall is None:
            change = trace.momentum_N_s - trace.momentum_N_s[0] - chain.load_N.sum() * trace.time_s
            largest = np.sqrt(2 * trace.kinetic_energy_J.max() * chain.mass_kg.sum())
            assert np.abs(change).max() < 1e-13 * largest


@pytest.mark.parametrize("kind", KINDS)
def test_codes_run_random_scenes_as_written(kind: str) -> None:
    case = adversarial_case(kind, 1)
    for engine in codes():
        need(engine)
        checks = budget_of(case, engine, compute(case, engine).done).checks
        verdicts = {check.quantity: check.verdict for check in checks if check.quantity.startswith("model: ")}
        assert verdicts.keys() == {"model: force", "model: energy", "model: momentum"}
        assert FAIL not in verdicts.values(), engine
