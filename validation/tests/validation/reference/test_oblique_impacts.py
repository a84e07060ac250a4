"""Oblique impacts on each engine against its tangential law, written out a second time; the law in closed form."""

from dataclasses import replace
from math import cos, radians, sin

import numpy as np
import pytest

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from drivers.run.compute import compute
from validation.tests.helpers.oblique_impact import (
    LIGGGHTS,
    YADE,
    ObliqueContact,
    TangentialLaw,
    integrate_oblique,
    sticking_restitution,
)
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import case_of

SPEED_M_S, RESTITUTION = 3.9, 0.98
BY_LAW = {"liggghts": LIGGGHTS, "yade": YADE, "verlet": LIGGGHTS}
ROUNDED = 1e-11  # of the speed: measured up to 3e-13


def case_at(degrees: float, *settings: str) -> Case:
    """The scene at another angle; its coarse step suffices, since code and law are compared at the same step."""
    normal, tangential = velocities(degrees)
    return case_of(
        "oblique-impact",
        f'chain.bead.0.velocity="{-normal!r} m/s"',
        f'chain.bead.0.lateral_velocity="{tangential!r} m/s"',
        'run.time_step="4 ns"',
        *settings,
    )


def velocities(degrees: float) -> tuple[float, float]:
    """Speeds towards the plane and along it."""
    return SPEED_M_S * cos(radians(degrees)), SPEED_M_S * sin(radians(degrees))


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
    law, other = BY_LAW[engine], LIGGGHTS if BY_LAW[engine].incremental else YADE
    contact, (normal, tangential) = contact_of(case), velocities(degrees)
    rebound = integrate_oblique(contact, law, normal, tangential, case.scene.time_step_s)
    trace = traced(engine, case)
    along, up, spin = (values[-1, 0] for values in motion_of(trace))
    assert abs(up - rebound.normal_m_s) < ROUNDED * SPEED_M_S
    assert abs(along - rebound.tangential_m_s) < ROUNDED * SPEED_M_S
    assert abs(spin - rebound.spin_rad_s) < ROUNDED * SPEED_M_S / contact.radius_m
    assert up / normal == pytest.approx(RESTITUTION, abs=1e-5)  # error of the step; 1e-6 at 1 ns
    if degrees < 30:
        wrong = integrate_oblique(contact, other, normal, tangential, case.scene.time_step_s)
        assert abs(along - wrong.tangential_m_s) > 5e-4 * SPEED_M_S
    else:  # it slides throughout: momentum alone gives the rebound, but a few of the first and last steps stick
        assert along == pytest.approx(tangential - contact.friction * (1 + RESTITUTION) * normal, rel=5e-5)
    assert trace.total_energy_J[-1] < trace.total_energy_J[0]


@pytest.mark.parametrize("engine", ["yade", "verlet"])
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


@pytest.mark.parametrize("steps", [500, 2000])
@pytest.mark.parametrize(("law", "order", "factor"), [(LIGGGHTS, 1.5, 1.0), (YADE, 1.0, 5.0)], ids=["liggghts", "yade"])
def test_without_slip_the_law_rebounds_in_closed_form(
    law: TangentialLaw, order: float, factor: float, steps: int
) -> None:
    """The impact is slow, so that the overlap is much smaller than the radius; friction is practically infinite."""
    contact = replace(contact_of(case_at(45.0)), friction=1e6, damping_ratio=0.0)
    normal, tangential = 1e-6, 1e-7
    duration_s = integrate_oblique(contact, law, normal, tangential, 1e-7).duration_s
    rebound = integrate_oblique(contact, law, normal, tangential, duration_s / steps)
    touching_m_s = rebound.tangential_m_s - contact.radius_m * rebound.spin_rad_s
    # The factors are at least 1.4 times the largest measured ones. The contact ends within a step, with YADE's force
    # still acting; the overlap enters through the arms.
    allowed = factor / steps**order + rebound.overlap_m / contact.radius_m
    assert abs(touching_m_s / tangential - sticking_restitution(contact)) < allowed
