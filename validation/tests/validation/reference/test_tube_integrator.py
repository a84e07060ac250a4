"""In-repo Verlet in three dimensions: conservation laws, and both codes against it, each with its tangential law."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.chain.chain import arrays_of, energy_put_in, tube_arrays_of
from drivers.chain.elements import SIDEWAYS
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import until
from drivers.engines import INCREMENTAL, TOTAL, codes, load_engine
from drivers.limits.energy_bounds import certainly_stable
from drivers.limits.refusal import FORCE, refuse
from drivers.limits.stable_step import linear_limit, linear_sideways_limit, predicted_limit
from postproc.read.residual import residual
from validation.accuracy.budget import budget_of
from validation.accuracy.motions import AGREEMENT, Motions
from validation.reference.hertz_chain import TubeMotion
from validation.reference.tube import integrate_tube
from validation.reference.velocity_verlet import integrate_verlet
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import case_of

OFF_AXIS = 'chain.lateral_offset="30 um"'
SLIPPERY, STICKY = ("tube.friction=0",), ("contact.friction=0.5", "tube.friction=0.3")
DAMPED, FREE = (*STICKY, "contact.restitution=0.9"), (*STICKY, "wall=", "gravity=")
LAWS = (TOTAL, INCREMENTAL)
ROUNDED = 1e-9  # share of the largest force; measured: up to 1e-11


def sideways(*settings: str) -> Case:
    return case_of("fig4", OFF_AXIS, 'run.duration="0.4 ms"', *settings)


def motion_of(case: Case, finer: int = 1, law: str = TOTAL) -> TubeMotion:
    scene = case.scene
    return integrate_tube(
        tube_arrays_of(case.chain), scene.time_step_s / finer, finer * scene.steps_per_sample, scene.samples, law
    )


@pytest.mark.parametrize("settings", [SLIPPERY, DAMPED, FREE], ids=["slippery", "damped", "free"])
def test_codes_agree_with_the_integrator(settings: tuple[str, ...], shared_runs: Path) -> None:
    case = sideways(*settings, 'run.record=["forces","state"]')
    motions = {law: motion_of(case, law=law) for law in LAWS}
    for engine in ("liggghts", "yade", *(["verlet"] if settings == DAMPED else [])):
        run = finished(case, engine, shared_runs)
        law = load_engine(engine).shear
        expected = motions[law]
        largest = expected.force_N.max()
        assert np.abs(run.trace.force_N - expected.force_N).max() < ROUNDED * largest
        assert not run.record.warnings
        if settings != SLIPPERY:  # and differs from the other law
            assert np.abs(run.trace.force_N - motions[LAWS[law == TOTAL]].force_N).max() > 1e-5 * largest
        state = pd.read_parquet(run.folder / "state.parquet")
        for name, values in (
            ("spin_{}_rad_s", expected.spin_rad_s),
            ("{}_velocity_m_s", expected.velocity_m_s[:, :, :2]),
        ):
            for axis in range(values.shape[2]):
                columns = [f"body_{j}_{name.format('xyz'[axis])}" for j in range(1, case.chain.bodies + 1)]
                assert np.abs(state[columns].to_numpy() - values[:, :, axis]).max() <= 1e-7 * np.abs(values).max()


def test_without_friction_the_energy_error_is_of_second_order() -> None:
    case = sideways(*SLIPPERY)
    put_in = energy_put_in(case.chain, float(case.sample_times_s[-1]))
    errors = [float(np.ptp(verlet_of(case, TOTAL, finer).total_energy_J)) / put_in for finer in (1, 2)]
    assert errors[0] < 1e-5
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.1)


def test_without_friction_angular_momentum_about_the_axis_is_conserved() -> None:
    case = sideways(*SLIPPERY)
    motion = motion_of(case)
    place, velocity = motion.place_m, motion.velocity_m_s
    about = case.chain.mass_kg * (place[:, :, 0] * velocity[:, :, 1] - place[:, :, 1] * velocity[:, :, 0])
    total = about.sum(axis=1)
    # single beads change their angular momentum, but contacts and bore only pass it on
    assert np.abs(about - about[0]).max() > 1e-13
    assert np.abs(total - total[0]).max() < 1e-9 * np.abs(about).max()
    assert not motion.spin_rad_s.any()


def test_friction_in_the_bore_dissipates_energy() -> None:
    slippery, rough = (verlet_of(sideways(setting), TOTAL) for setting in ("tube.friction=0", "tube.friction=0.3"))
    lost = rough.total_energy_J[0] - rough.total_energy_J
    assert lost[-1] > 1e-3 * rough.kinetic_energy_J[0]
    assert lost.min() >= -1e-9 * rough.kinetic_energy_J[0]
    assert abs(slippery.total_energy_J[-1] - slippery.total_energy_J[0]) < 1e-3 * lost[-1]


def test_a_chain_on_the_axis_moves_as_a_straight_chain() -> None:
    case = sideways(*STICKY)
    assert case.chain.lateral is not None
    straight = case_of("fig4", 'run.duration="0.4 ms"')
    nowhere = np.zeros((case.chain.bodies, 2))
    chain = replace(straight.chain, lateral=replace(case.chain.lateral, offset_m=nowhere))
    motion = motion_of(replace(straight, chain=chain))
    expected = integrate_verlet(
        arrays_of(straight.chain), straight.scene.time_step_s, straight.scene.steps_per_sample, straight.scene.samples
    )
    assert np.abs(motion.force_N - expected.force_N).max() < ROUNDED * expected.force_N.max()
    assert not motion.place_m[:, :, :2].any()


def test_the_horizon_ends_where_rounding_separates_two_runs() -> None:
    case = case_of(
        "fig4",
        'chain.lateral_offset="100 um"',
        *STICKY,
        'run.duration="20 ms"',
        'run.sample_interval="20 us"',
        'run.time_step="1 us"',
    )
    motions = Motions(case, TOTAL)
    assert 1 < motions.samples < case.scene.samples
    chain = tube_arrays_of(case.chain)
    nudged = replace(chain, place_m=np.nextafter(chain.place_m, np.inf))
    timing = (case.scene.time_step_s, case.scene.steps_per_sample, case.scene.samples)
    apart = np.abs(integrate_tube(nudged, *timing).force_N - integrate_tube(chain, *timing).force_N).max(axis=1)
    share = apart / np.abs(motions.plain.force_N).max()
    assert share[: motions.known].max() < 1e-5
    assert (share[: motions.samples] <= motions.explained(FORCE)).all()
    assert share.max() > AGREEMENT


def test_the_budget_adds_up_and_names_what_it_omits() -> None:
    case = sideways(*STICKY)
    for engine in ("liggghts", "yade"):
        law = load_engine(engine).shear
        budget = budget_of(case, engine, verlet_of(case, law))
        force = budget.rows[0]
        assert force["whole"] == pytest.approx(
            force["model"] + force["rounding"] + force["truncation"] + force["sampling"], abs=1e-15
        )
        assert "order of convergence" in budget.note
        assert "sampling not measured" in budget.note
        fine = verlet_of(case, law, 16)
        true = residual(verlet_of(case, law), fine).max()
        assert abs(force["truncation"]) == pytest.approx(true, rel=0.1)


def test_a_run_with_the_other_law_gets_a_warning() -> None:
    case = sideways(*STICKY)
    found = budget_of(case, "yade", verlet_of(case, TOTAL)).warnings
    assert len(found) == 1
    assert "did not run the scene as written" in found[0]


def test_the_stability_limit_is_below_the_blow_up() -> None:
    for settings in (SLIPPERY, ("contact.friction=5", "tube.friction=5")):
        case = sideways(*settings)
        duration = float(case.sample_times_s[-1])
        limit = predicted_limit(case.chain, duration)
        gains = []
        for share in (1.0, 1.6):
            run = case.sampled_at_every(share * limit)
            energy = np.nan_to_num(verlet_of(run, TOTAL).total_energy_J, nan=np.inf)
            gains.append(float((energy - energy[0]).max()) / energy_put_in(case.chain, duration))
        assert gains[0] < 1 < gains[1]
        assert not certainly_stable(case.chain, duration, 1e-3 * limit)
        refuse(case.sampled_at_every(1.01 * limit), "verlet")
        with pytest.raises(InputError, match=r"time_step: .* a trial at this step is unstable"):
            refuse(case.sampled_at_every(2.5 * limit), "verlet")


def test_stability_limits_of_a_uniform_chain() -> None:
    """Largest squared frequencies without the bore: ``4 K/m`` axial, ``10 k/m`` for equal spins of neighbours."""
    chain = case_of("fig4", OFF_AXIS, "chain.count=400", "wall=", "gravity=", "run.duration=1 us").chain
    mass, n = chain.mass_kg[50], chain.bodies
    alike, none = np.ones(n), np.zeros(n)
    chain = replace(chain, mass_kg=np.full(n, mass))
    assert linear_sideways_limit(chain, alike, none, none, none) == pytest.approx(linear_limit(chain, alike), rel=1e-9)
    assert linear_sideways_limit(chain, none, alike, none, none) == pytest.approx(2 / np.sqrt(10 / mass), rel=1e-3)
    assert linear_sideways_limit(chain, none, none, none, alike) == pytest.approx(2 / np.sqrt(3.5 / mass), rel=1e-9)


def test_cutting_a_trace_cuts_all_its_arrays() -> None:
    trace = verlet_of(sideways(*SLIPPERY), TOTAL)
    cut = until(trace, 7)
    assert cut.spin_rad_s is not None
    assert len(cut.force_N) == len(cut.spin_rad_s) == len(cut.time_s) == 7


@pytest.mark.parametrize("engine", [name for name in codes() if load_engine(name).models >= SIDEWAYS])
def test_beads_without_rotation(engine: str, shared_runs: Path) -> None:
    case = case_of("fig4-tube", "contact.rotation=false", "contact.friction=0.3", "run.duration=0.3 ms")
    run = finished(case, engine, shared_runs)
    verlet = verlet_of(case, load_engine(engine).shear)
    assert residual(run.trace, verlet).max() < 1e-9
    turning = verlet_of(case_of("fig4-tube", "contact.friction=0.3", "run.duration=0.3 ms"), load_engine(engine).shear)
    assert residual(turning, verlet).max() > 1e-3
