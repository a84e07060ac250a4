"""Oblique impacts on each engine against its tangential law, written out a second time; the law in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from drivers.run.compute import compute
from validation.tests.helpers.oblique_impact import (
    LIGGGHTS,
    YADE,
    YADE_ONE_ARM,
    ObliqueContact,
    Rebound,
    TangentialLaw,
    gross_sliding,
    integrate_half_space,
    integrate_oblique,
    sticking_restitution,
)
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import case_of

SPEED_M_S, RESTITUTION = 3.9, 0.98
BY_LAW = {"liggghts": LIGGGHTS, "yade": YADE_ONE_ARM, "verlet": LIGGGHTS}
ROUNDED = 1e-11  # of the speed: measured up to 3e-13
LAWS = pytest.mark.parametrize("law", [LIGGGHTS, YADE], ids=["liggghts", "yade"])


def case_at(degrees: float, *settings: str) -> Case:
    """The scene at another angle; its coarse step suffices, since code and law are compared at the same step."""
    normal, tangential = velocities(degrees)
    return case_of(
        "oblique-impact",
        f'chain.bead.0.velocity="{float(-normal)!r} m/s"',
        f'chain.bead.0.lateral_velocity="{float(tangential)!r} m/s"',
        'run.time_step="4 ns"',
        *settings,
    )


def velocities(degrees: float | Array) -> tuple[Array, Array]:
    """Speeds towards the plane and along it."""
    return SPEED_M_S * np.cos(np.radians(degrees)), SPEED_M_S * np.sin(np.radians(degrees))


def contact_of(case: Case) -> ObliqueContact:
    """The ball and its plane, from the arrays of the chain."""
    chain = case.chain
    assert chain.lateral is not None
    stiffness, shear = float(chain.stiffness[0]), float(chain.lateral.shear_stiffness[0])
    ratio = getattr(chain.law, "damping_ratio", 0.0)
    radius, mass = float(chain.radius_m[0]), float(chain.mass_kg[0])
    return ObliqueContact(radius, mass, stiffness, shear, case.scene.contact.friction, ratio)


def traced(engine: str, case: Case) -> Trace:
    need(engine)
    return compute(case, engine, limit_s=60.0).done


def motion_of(trace: Trace) -> tuple[Array, Array, Array]:
    """Velocities along x and z and spin about y. Shape (samples, bodies) each."""
    assert trace.across_velocity_m_s is not None
    assert trace.velocity_m_s is not None
    assert trace.spin_rad_s is not None
    return trace.across_velocity_m_s[:, :, 0], trace.velocity_m_s, trace.spin_rad_s[:, :, 1]


@pytest.mark.parametrize("engine", BY_LAW)
@pytest.mark.parametrize(
    ("degrees", "material"), [(5.0, "aluminium-oxide"), (20.0, "aluminium-alloy"), (60.0, "aluminium-oxide")]
)
def test_engines_rebound_by_their_laws(degrees: float, material: str, engine: str) -> None:
    case = case_at(degrees, f'chain.material="{material}"')
    law, other = BY_LAW[engine], LIGGGHTS if BY_LAW[engine].incremental else YADE_ONE_ARM
    contact, (normal, tangential) = contact_of(case), velocities(degrees)
    expected, others = (
        integrate_oblique(contact, each, normal, tangential, case.scene.time_step_s) for each in (law, other)
    )
    trace = traced(engine, case)
    along, up, spin = motion_of(trace)
    for got, value in (
        (up[-1, 0], expected.normal_m_s),
        (along[-1, 0], expected.tangential_m_s),
        (contact.radius_m * spin[-1, 0], contact.radius_m * expected.spin_rad_s),
    ):
        assert abs(got - value) < ROUNDED * SPEED_M_S
    assert up[-1, 0] / normal == pytest.approx(RESTITUTION, abs=1e-5)  # error of the step; 1e-6 at 1 ns
    if degrees < 30:
        assert abs(along[-1, 0] - others.tangential_m_s) > 5e-4 * SPEED_M_S
    else:
        slid, _ = gross_sliding(contact, RESTITUTION, normal, tangential)
        assert along[-1, 0] == pytest.approx(float(slid), rel=5e-5)  # a few of the first and last steps stick
    assert trace.total_energy_J[-1] < trace.total_energy_J[0]


def test_spins_belong_to_the_time_of_the_forces() -> None:
    step = 10e-9
    timing = ('run.duration="4 us"', 'run.sample_interval="10 ns"', 'run.time_step="10 ns"')
    case = case_at(45.0, *timing)
    trace, contact = traced("verlet", case), contact_of(case)
    assert trace.height_m is not None
    force = trace.force_N[:, 0]
    arm = (contact.radius_m + trace.height_m[:, 0]) / 2
    along, _, spin = motion_of(trace)
    # sliding: friction is mu times the normal force; values change between samples by the mean of their rates
    for values, rate in (
        (spin, contact.friction * force * arm / (0.4 * contact.mass_kg * contact.radius_m**2)),
        (-along, contact.friction * force / contact.mass_kg),
    ):
        mean, late = step * (rate[1:] + rate[:-1]) / 2, step * rate[:-1]
        sliding = slice(100, None)  # the first steps of a damped contact stick
        assert np.abs(np.diff(values[:, 0]) - mean)[sliding].max() < 1e-9 * mean.max()
        assert np.abs(late - mean)[sliding].max() > 1e-3 * mean.max()  # a shift by half a step would show


@pytest.mark.parametrize("engine", BY_LAW)
def test_two_free_beads_keep_their_momenta(engine: str) -> None:
    upper = '{from_wall=2, diameter="3 mm", velocity="-3 m/s", lateral_velocity="0.4 m/s"}'
    case = case_at(30.0, "wall=", "chain.count=2", f"chain.bead=[{upper}]", "contact.friction=0.3")
    trace = traced(engine, case)
    assert trace.height_m is not None
    assert trace.across_m is not None
    mass, radius = case.chain.mass_kg, case.chain.radius_m
    vx, vz, spin = motion_of(trace)
    assert (np.abs(spin).max(axis=0) > 10).all()  # friction acts and turns both
    turning = (trace.height_m * vx - trace.across_m[:, :, 0] * vz) @ mass + spin @ (0.4 * mass * radius**2)
    # rounding: 4e-15 for linear, 2e-13 for angular momentum, since free flight rounds heights in one direction
    for momentum in (vx @ mass, vz @ mass, turning):
        assert np.ptp(momentum) < 1e-12 * np.abs(momentum[0])


@LAWS
def test_wide_angles_slide_as_rigid_bodies_do(law: TangentialLaw) -> None:
    contact = replace(contact_of(case_at(45.0)), damping_ratio=0.0)
    normal, tangential = velocities(np.arange(35.0, 86.0, 5.0))
    rebound = integrate_oblique(contact, law, normal, tangential, 1e-9)
    slid, spin = gross_sliding(contact, rebound.normal_m_s / normal, normal, tangential)
    np.testing.assert_allclose(rebound.tangential_m_s, slid, rtol=1e-12)
    # the arm of the torque is shorter than the radius by at most the overlap (YADE) or half of it (LIGGGHTS)
    short = 1 - rebound.spin_rad_s / spin
    assert (short > 0).all()
    assert (short < law.torque_arm * rebound.overlap_m / contact.radius_m).all()


@pytest.mark.parametrize("steps", [500, 2000])
@pytest.mark.parametrize(("law", "order", "factor"), [(LIGGGHTS, 1.5, 1.0), (YADE, 1.0, 5.0)], ids=["liggghts", "yade"])
def test_without_slip_the_law_rebounds_in_closed_form(
    law: TangentialLaw, order: float, factor: float, steps: int
) -> None:
    """The impact is slow, so that the overlap is much smaller than the radius; friction is practically infinite."""
    contact = replace(contact_of(case_at(45.0)), friction=1e6, damping_ratio=0.0)
    normal, tangential = 1e-6, 1e-7
    duration_s = float(integrate_oblique(contact, law, normal, tangential, 1e-7).duration_s)
    rebound = integrate_oblique(contact, law, normal, tangential, duration_s / steps)
    # The factors are at least 1.4 times the largest measured ones. The contact ends within a step, with YADE's force
    # still acting; the overlap enters through the arms.
    allowed = factor / steps**order + float(rebound.overlap_m) / contact.radius_m
    assert abs(rebound.contact_m_s(contact.radius_m) / tangential - sticking_restitution(contact)) < allowed


def test_codes_deviate_from_elastic_theory_as_documented() -> None:
    """Both codes return too much energy to sticking contacts; from 30 degrees on, contacts slide as in theory."""
    contact, (normal, tangential) = contact_of(case_at(30.0)), velocities(np.array([5.0, 10.0, 20.0, 30.0]))

    def restitution(rebound: Rebound) -> Array:
        return rebound.tangential_m_s / tangential

    theory = restitution(integrate_half_space(contact, normal, tangential, 1e-9))
    for law, known in ((LIGGGHTS, [0.214, 0.058, 0.025, 0.0]), (YADE, [0.152, 0.074, 0.014, 0.0])):
        deviation = restitution(integrate_oblique(contact, law, normal, tangential, 1e-9)) - theory
        assert deviation == pytest.approx(known, abs=1e-3)
