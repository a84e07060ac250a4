"""The shipped oblique impact on each engine against its own tangential law, and friction between two free beads."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from drivers.engines import INCREMENTAL, load_engine
from drivers.run.compute import compute
from validation.tests.helpers.oblique_impact import (
    LIGGGHTS,
    YADE_ONE_ARM,
    ObliqueContact,
    TangentialLaw,
    gross_sliding,
    integrate_oblique,
    sticking_restitution,
)
from validation.tests.helpers.runs import finished, need
from validation.tests.helpers.scenes import case_of

RADIUS_M, SPEED_M_S, FRICTION, RESTITUTION = 2.5e-3, 3.9, 0.092, 0.98
ANGLES = (5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 85.0)
BY_LAW = {"liggghts": LIGGGHTS, "yade": YADE_ONE_ARM, "verlet": LIGGGHTS}
ENGINES = pytest.mark.parametrize("engine", BY_LAW)
MATERIALS = pytest.mark.parametrize("material", ["aluminium-oxide", "aluminium-alloy"])
ROUNDED = 1e-11  # of the speed: measured up to 3e-13

Motion = tuple[float, float, float]  # velocity away from the plane, along it, and radius times spin
Runner = Callable[[str, Case], Trace]


@pytest.fixture
def traced() -> Runner:
    """Runner of cases as in batches."""

    def run(engine: str, case: Case) -> Trace:
        need(engine)
        return compute(case, engine, limit_s=60.0).done

    return run


@dataclass(frozen=True)
class Impact:
    """Motion of the ball at the start and after the impact, and the largest component that must be zero."""

    start: Motion
    rebound: Motion
    out_of_plane: float


def sideways(trace: Trace) -> tuple[Array, Array, Array]:
    """Positions and velocities across the axis, and spins."""
    assert trace.across_m is not None
    assert trace.across_velocity_m_s is not None
    assert trace.spin_rad_s is not None
    return trace.across_m, trace.across_velocity_m_s, trace.spin_rad_s


def case_at(degrees: float, material: str, *settings: str) -> Case:
    """The scene at another angle; its coarse step suffices, since code and law are compared at the same step."""
    angle = np.radians(degrees)
    return case_of(
        "oblique-impact",
        f'chain.material="{material}"',
        f'chain.bead.0.velocity="{float(-SPEED_M_S * np.cos(angle))!r} m/s"',
        f'chain.bead.0.lateral_velocity="{float(SPEED_M_S * np.sin(angle))!r} m/s"',
        'run.time_step="4 ns"',
        *settings,
    )


def impact_of(trace: Trace) -> Impact:
    assert trace.height_m is not None
    assert trace.velocity_m_s is not None
    across, velocity, spin = sideways(trace)
    assert trace.height_m[-1, 0] > RADIUS_M  # it has left
    motion = np.column_stack([trace.velocity_m_s[:, 0], velocity[:, 0, 0], RADIUS_M * spin[:, 0, 1]])
    out_of_plane = [
        across[:, 0, 1],
        velocity[:, 0, 1],
        spin[:, 0, 0],
        spin[:, 0, 2],
    ]
    (a, b, c), (d, e, f) = motion[0].tolist(), motion[-1].tolist()
    return Impact((a, b, c), (d, e, f), float(np.abs(out_of_plane).max()))


def contact_of(case: Case) -> ObliqueContact:
    """The ball and its plane, from the arrays of the chain."""
    chain = case.chain
    assert chain.lateral is not None
    stiffness, shear = float(chain.stiffness[0]), float(chain.lateral.shear_stiffness[0])
    friction = case.scene.contact.friction
    return ObliqueContact(
        RADIUS_M, float(chain.mass_kg[0]), stiffness, shear, friction, getattr(chain.law, "damping_ratio", 0.0)
    )


def rebound_by(law: TangentialLaw, case: Case) -> Motion:
    """Rebound with a given law at the scene's step."""
    chain = case.chain
    assert chain.lateral is not None
    normal, tangential = -chain.velocity_m_s[0], chain.lateral.velocity_m_s[0, 0]
    rebound = integrate_oblique(contact_of(case), law, normal, tangential, case.scene.time_step_s)
    return float(rebound.normal_m_s), float(rebound.tangential_m_s), RADIUS_M * float(rebound.spin_rad_s)


@MATERIALS
@ENGINES
@pytest.mark.parametrize("degrees", ANGLES)
def test_engines_rebound_by_their_laws(degrees: float, engine: str, material: str, traced: Runner) -> None:
    case = case_at(degrees, material)
    trace = traced(engine, case)
    impact = impact_of(trace)
    law = BY_LAW[engine]
    for got, expected in zip(impact.rebound, rebound_by(law, case), strict=True):
        assert abs(got - expected) < ROUNDED * SPEED_M_S
    assert impact.out_of_plane == 0.0
    normal, tangential = -impact.start[0], impact.start[1]
    assert impact.rebound[0] / normal == pytest.approx(RESTITUTION, abs=1e-5)  # error of the step; 1e-6 at 1 ns
    if degrees < 30:  # and differs from the other law
        other = LIGGGHTS if law.incremental else YADE_ONE_ARM
        assert abs(impact.rebound[1] - rebound_by(other, case)[1]) > 5e-4 * SPEED_M_S
    else:
        slid, _ = gross_sliding(contact_of(case), RESTITUTION, normal, tangential)
        # a few of the first and last steps stick, with little force: 2e-5, and 4e-6 at 1 ns
        assert impact.rebound[1] == pytest.approx(float(slid), rel=5e-5)
    energy_J = trace.total_energy_J
    assert energy_J[-1] < energy_J[0]
    assert (energy_J <= energy_J[0] * (1 + 1e-12)).all()  # elastic shear energy is not counted and returns


@ENGINES
def test_sticking_impacts_gain_what_their_law_gains(engine: str, traced: Runner) -> None:
    case = case_at(2.0, "aluminium-oxide", "contact.restitution=")
    law, mass = BY_LAW[engine], case.chain.mass_kg[0]
    impact = impact_of(traced(engine, case))
    before, *after = (
        mass / 2 * (normal**2 + along**2 + 0.4 * turning**2)
        for normal, along, turning in (impact.start, impact.rebound, rebound_by(law, case))
    )
    assert after[0] == pytest.approx(after[1], rel=1e-12)
    # the effective mass of the contact point is 2/7 of the mass; the laws have no potential (test_oblique)
    exact = mass / 7 * impact.start[1] ** 2 * (sticking_restitution(contact_of(case)) ** 2 - 1)
    assert (after[0] < before) if law.incremental else (0.5 * exact < after[0] - before < exact)


@ENGINES
def test_spins_belong_to_the_time_of_the_forces(engine: str, traced: Runner) -> None:
    step = 10e-9
    timing = ('run.duration="4 us"', 'run.sample_interval="10 ns"', 'run.time_step="10 ns"')
    case = case_at(45.0, "aluminium-oxide", *timing)
    trace = traced(engine, case)
    assert trace.height_m is not None
    force, mass = trace.force_N[:, 0], case.chain.mass_kg[0]
    arm = RADIUS_M - BY_LAW[engine].torque_arm * (RADIUS_M - trace.height_m[:, 0])
    _, velocity, spins = sideways(trace)
    spin, along = spins[:, 0, 1], velocity[:, 0, 0]
    # sliding: friction is mu times the normal force; values change between samples by the mean of their rates
    for values, rate in (
        (spin, FRICTION * force * arm / (0.4 * mass * RADIUS_M**2)),
        (-along, FRICTION * force / mass),
    ):
        mean, late = step * (rate[1:] + rate[:-1]) / 2, step * rate[:-1]
        sliding = slice(100, None)  # the first steps of a damped contact stick
        assert np.abs(np.diff(values) - mean)[sliding].max() < 1e-9 * mean.max()
        assert np.abs(late - mean)[sliding].max() > 1e-3 * mean.max()  # a shift by half a step would show


@ENGINES
@pytest.mark.parametrize("across", [0.4, 2.0], ids=["sticks", "slides"])
def test_two_free_beads_keep_their_momenta(across: float, engine: str, traced: Runner) -> None:
    upper = f'{{from_wall=2, diameter="3 mm", velocity="-3 m/s", lateral_velocity="{across} m/s"}}'
    case = case_at(30.0, "aluminium-oxide", "wall=", "chain.count=2", f"chain.bead=[{upper}]", "contact.friction=0.3")
    trace = traced(engine, case)
    assert trace.height_m is not None
    assert trace.velocity_m_s is not None
    mass, radius = case.chain.mass_kg, case.chain.radius_m
    x, vx, spin = (values[:, :, axis] for values, axis in zip(sideways(trace), (0, 0, 1), strict=True))
    z, vz = trace.height_m, trace.velocity_m_s
    assert (np.abs(spin).max(axis=0) > 10).all()  # friction acts and turns both
    turning = (z * vx - x * vz) @ mass + spin @ (0.4 * mass * radius**2)
    # rounding: 4e-15 for linear, 2e-13 for angular momentum, since free flight rounds heights in one direction
    for momentum in (vx @ mass, vz @ mass, turning):
        assert np.ptp(momentum) < 1e-12 * np.abs(momentum[0])


@ENGINES
def test_the_shipped_scene_as_it_is(engine: str, shared_runs: Path) -> None:
    case = case_of("oblique-impact")
    run = finished(case, engine, shared_runs)
    assert (load_engine(engine).shear == INCREMENTAL) == BY_LAW[engine].incremental
    assert not run.record.warnings
    last = pd.read_parquet(run.folder / "state.parquet").iloc[-1]
    normal, along, turning = rebound_by(BY_LAW[engine], case)
    assert last["body_1_velocity_m_s"] == pytest.approx(normal, abs=ROUNDED * SPEED_M_S)
    assert last["body_1_x_velocity_m_s"] == pytest.approx(along, abs=ROUNDED * SPEED_M_S)
    assert RADIUS_M * last["body_1_spin_y_rad_s"] == pytest.approx(turning, abs=ROUNDED * SPEED_M_S)
    assert last["body_1_x_velocity_m_s"] / 1.95 == pytest.approx(1 - FRICTION * 1.98 / np.tan(np.radians(30)), abs=1e-5)
