"""Total energy: its changes are exact to rounding however large the static load, on random chains and motions."""

from decimal import Decimal, localcontext

import numpy as np
import pytest

from drivers.base import paths
from drivers.chain.case import Case, build_case
from drivers.chain.chain import Array, Chain
from drivers.chain.schemes import exact_of, verlet_in_heights, verlet_of
from drivers.chain.trace import Trace, energy_error_J, potential_energy_change
from drivers.scene.read_scene import make_scene, read_toml
from validation.tests.helpers.adversarial import KINDS, adversarial_case

DIGITS = 40


def pressed_case(number: int, *, damped: bool) -> Case:
    """A random pressed chain of steel, struck at 1e-8 m/s to 1 m/s for three traverses; some beads hang free."""
    draw = np.random.default_rng([number, damped])
    count, diameter_m = int(draw.integers(1, 40)), draw.uniform(1e-3, 1e-2)
    load_N = 10 ** draw.uniform(-3, 1) * (diameter_m / 5e-3) ** 2
    chain = {"count": count, "material": "steel", "diameter": f"{diameter_m} m", "precompression": f"{load_N} N"}
    striker = {"material": "steel", "diameter": f"{diameter_m} m", "speed": f"{10 ** draw.uniform(-8, 0)} m/s"}
    data = {"chain": chain, "striker": striker, "wall": {"material": "steel"}}
    data |= {"gravity": "9.81 m/s^2"} if draw.random() < 0.5 else {}
    data |= {"contact": {"damping_ratio": draw.uniform(0.001, 0.1)}} if damped else {}
    data["run"] = {"duration": "1 s", "sample_interval": "1 ms", "time_step": "1 ms"}
    library = read_toml(paths.MATERIALS)
    first = build_case(make_scene(data, library, "pressed", "a pressed chain")).chain
    contact_s = np.sqrt(first.mass_kg[0] / (1.5 * first.stiffness[0] ** (2 / 3) * load_N ** (1 / 3)))
    step = f"{contact_s / 20:.4g} s"
    data["run"] = {
        "duration": f"{int(60 * count + 200) * float(step[:-2])} s",
        "sample_interval": step,
        "time_step": step,
    }
    return build_case(make_scene(data, library, "pressed", "a pressed chain"))


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
def test_the_potential_energy_is_its_definition(kind: str) -> None:
    for number in range(20):
        chain = adversarial_case(kind, number).chain
        draw = np.random.default_rng(number)
        size_m = np.abs(chain.overlap_m).max() * 10 ** draw.uniform(-9, 1)
        moved = size_m * draw.standard_normal((5, chain.bodies))
        change = -np.diff(moved, axis=1, prepend=0.0)
        terms = np.abs(chain.load_N * moved).sum(axis=1) + (chain.stiffness * np.abs(change) ** 2.5).sum(axis=1)
        exact = [exact_change(chain, row) for row in moved]
        assert np.abs(potential_energy_change(chain, moved) - exact).max() <= 1e-13 * terms.max()


def drift(trace: Trace) -> float:
    return float(np.abs(trace.total_energy_J - trace.total_energy_J[0]).max() / trace.kinetic_energy_J.max())


@pytest.mark.parametrize("number", range(12))
def test_no_static_load_hides_the_energy_of_a_weak_wave(number: int) -> None:
    case = pressed_case(number, damped=False)
    assert drift(exact_of(case)) < 1e-6
    coarse = drift(verlet_of(case))
    assert coarse < 1e-2
    fine = drift(verlet_of(case, finer=4))
    assert fine == pytest.approx(coarse / 16, rel=0.1, abs=1e-8)  # truncation, no rounding
    assert drift(verlet_in_heights(case)) == pytest.approx(coarse, rel=0.01, abs=2e-4)


@pytest.mark.parametrize("number", range(6))
def test_damping_only_takes_the_energy_of_a_weak_wave(number: int) -> None:
    case = pressed_case(number, damped=True)
    trace = exact_of(case)
    gained_J = energy_error_J(trace.total_energy_J, damped=True, slips=False).max()
    lost_J = trace.total_energy_J[0] - trace.total_energy_J[-1]
    assert gained_J < 1e-6 * trace.kinetic_energy_J.max()
    assert 1e-3 * trace.kinetic_energy_J.max() < lost_J
