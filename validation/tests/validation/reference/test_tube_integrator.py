"""In-repo Verlet in three dimensions: conservation laws, and codes against it, each with its tangential law."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.chain.chain import arrays_of, tube_arrays_of
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import residual
from drivers.engines import load_engine
from drivers.limits import refuse, step_limit, two_over_omega
from validation.accuracy.budget import budget_of
from validation.reference.hertz_chain import Extremes, TubeMotion
from validation.reference.tube import LAWS, TOTAL, integrate_tube
from validation.reference.velocity_verlet import follow_verlet, integrate_verlet
from validation.tests.helpers.runs import TUBE_CODES, finished
from validation.tests.helpers.scenes import case_of

OFF_AXIS = 'chain.lateral_offset="30 um"'
SLIPPERY, STICKY = ("tube.friction=0",), ("contact.friction=0.5", "tube.friction=0.3")
DAMPED, FREE = (*STICKY, "contact.restitution=0.9"), (*STICKY, "wall=", "gravity=")
ROUNDED = 1e-9  # share of the largest force; measured: up to 1e-11


def sideways(*settings: str) -> Case:
    return case_of("fig4", OFF_AXIS, 'run.duration="0.4 ms"', *settings)


def motion_of(case: Case, law: str = TOTAL) -> TubeMotion:
    scene = case.scene
    return integrate_tube(tube_arrays_of(case.chain), scene.time_step_s, scene.steps_per_sample, scene.samples, law)


@pytest.mark.parametrize("engine", TUBE_CODES)
@pytest.mark.parametrize("settings", [DAMPED, (*FREE, "contact.rotation=false")], ids=["damped", "free"])
def test_codes_agree_with_the_integrator(engine: str, settings: tuple[str, ...], shared_runs: Path) -> None:
    """Forces, spins and velocities are those of the code's law of friction; those of others differ if beads turn."""
    case = sideways(*settings, 'run.record=["forces","state"]')
    run, law = finished(case, engine, shared_runs), load_engine(engine).shear
    expected = motion_of(case, law)
    largest = expected.force_N.max()
    assert np.abs(run.trace.force_N - expected.force_N).max() < ROUNDED * largest
    for other in {*LAWS} - {law} if expected.spin_rad_s.any() else ():
        assert np.abs(run.trace.force_N - motion_of(case, other).force_N).max() > 1e-5 * largest
    assert not run.record.warnings
    state = pd.read_parquet(run.folder / "state.parquet")
    for name, values in (("spin_{}_rad_s", expected.spin_rad_s), ("{}_velocity_m_s", expected.velocity_m_s[:, :, :2])):
        for axis in range(values.shape[2]):
            columns = [f"body_{j}_{name.format('xyz'[axis])}" for j in range(1, case.chain.bodies + 1)]
            assert np.abs(state[columns].to_numpy() - values[:, :, axis]).max() <= 1e-7 * np.abs(values).max()


def test_without_friction_energy_and_angular_momentum_about_the_axis_are_conserved() -> None:
    case = sideways(*SLIPPERY)
    traces = [verlet_of(case, TOTAL, finer) for finer in (1, 2)]
    errors = [float(np.ptp(trace.total_energy_J) / trace.kinetic_energy_J.max()) for trace in traces]
    assert errors[0] < 1e-5
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)
    motion = motion_of(case)
    place, velocity = motion.place_m, motion.velocity_m_s
    about = case.chain.mass_kg * (place[:, :, 0] * velocity[:, :, 1] - place[:, :, 1] * velocity[:, :, 0])
    total = about.sum(axis=1)
    # single beads change their angular momentum, but contacts and bore only pass it on
    assert np.abs(about - about[0]).max() > 1e-13
    assert np.abs(total - total[0]).max() < 1e-9 * np.abs(about).max()
    assert not motion.spin_rad_s.any()


def test_a_chain_on_the_axis_moves_as_a_straight_chain() -> None:
    case, straight = sideways(*STICKY), case_of("fig4", 'run.duration="0.4 ms"')
    sideways_only = (
        *("shear_stiffness", "straight", "friction", "turns"),
        *("bore_m", "bore_stiffness", "bore_shear", "bore_friction"),
    )
    chain = replace(straight.chain, **{name: getattr(case.chain, name) for name in sideways_only})
    motion, scene = motion_of(replace(straight, chain=chain)), straight.scene
    expected = integrate_verlet(arrays_of(straight.chain), scene.time_step_s, scene.steps_per_sample, scene.samples)
    assert np.abs(motion.force_N - expected.force_N).max() < ROUNDED * expected.force_N.max()
    assert not motion.place_m[:, :, :2].any()
    coarse_s, steps = 15e-6, 20
    reached = integrate_tube(tube_arrays_of(chain), coarse_s, 2, steps // 2 + 1, extremes=True).extremes
    same = follow_verlet(arrays_of(straight.chain), coarse_s, steps)
    assert reached is not None
    assert reached.kinetic_J == pytest.approx(same.kinetic_J, rel=1e-9)
    assert reached.risen_J == pytest.approx(same.risen_J, rel=1e-6)
    assert same.risen_J > 1e-2 * same.kinetic_J


def test_the_budget_measures_the_truncation_and_names_the_other_law() -> None:
    case = sideways(*STICKY)
    budget = budget_of(case, "liggghts", verlet_of(case, TOTAL))
    force = budget.error_budget[0]
    true = residual(verlet_of(case, TOTAL), verlet_of(case, TOTAL, 16)).max()
    assert abs(force["truncation"]) == pytest.approx(true, rel=0.1)
    assert "sampling not measured" in budget.error_note
    *_, warning = budget_of(case, "yade", verlet_of(case, TOTAL)).warnings
    assert warning.startswith("departs from its scheme ")


@pytest.mark.parametrize("settings", [SLIPPERY, ("contact.friction=5", "tube.friction=5")])
def test_the_step_limit_is_just_below_the_blow_up(settings: tuple[str, ...]) -> None:
    case = sideways(*settings)
    stable_s, right_J = step_limit(case)[0], verlet_of(case).kinetic_energy_J.max()
    at_limit, beyond = (case.sampled_at_every(share * stable_s) for share in (1.0, 1.1))
    assert verlet_of(at_limit).kinetic_energy_J.max() < 2 * right_J
    assert not verlet_of(beyond).kinetic_energy_J.max() < 2 * right_J
    refuse(at_limit, "verlet")
    with pytest.raises(InputError, match=r"run.time_step: found .*; allowed: at most .*; a trial gains"):
        refuse(beyond, "verlet")


def test_two_over_omega_of_a_uniform_chain_is_at_most_that_of_its_modes() -> None:
    """Largest squared frequencies: ``4 K/m`` axial, ``10 k/m`` for equal spins of neighbours, ``3.5 k/m`` on a bore."""
    chain = sideways(*STICKY, "chain.count=400", "wall=", "gravity=", "run.duration=1 us").chain
    mass, ones = chain.mass_kg[50], np.ones(chain.bodies)
    chain = replace(chain, mass_kg=mass * ones)
    pressed, rubbed = (Extremes(1e-6 * ends * ones, 1e-6 * (1 - ends) * ones, 0 * ones, 0, 0) for ends in (1, 0))
    axial, spin, rub = 4 * 1.5 * chain.stiffness[50], 10 * chain.shear_stiffness[50], 3.5 * chain.bore_shear[50]
    squared = [4 / two_over_omega(chain, reached, 1e-7) ** 2 * mass / 1e-3 for reached in (pressed, rubbed)]
    assert max(axial, spin) * (1 - 1e-9) <= squared[0] < 1.5 * max(axial, spin)
    assert rub * (1 - 1e-9) <= squared[1]
    straight = replace(chain, straight=True)
    assert 4 / two_over_omega(straight, pressed, 1e-7) ** 2 * mass / 1e-3 == pytest.approx(axial, rel=1e-9)
