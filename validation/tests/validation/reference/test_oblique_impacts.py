"""Oblique impacts: codes against the in-repo integrator with their law of friction, and formulas against both laws."""

from dataclasses import replace
from math import cos, pi, radians, sin, sqrt

import numpy as np
import pytest

from drivers.chain.case import Case
from drivers.chain.chain import Array, tube_arrays_of
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import Trace
from drivers.engines import load_engine
from drivers.run.compute import compute
from validation.reference.tube import INCREMENTAL, LAWS, TOTAL, integrate_tube
from validation.tests.helpers.runs import TUBE_CODES, need
from validation.tests.helpers.scenes import case_of

SPEED_M_S, RESTITUTION = 3.9, 0.98
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


def motion_of(trace: Trace) -> tuple[Array, Array, Array]:
    """Velocities along x and z and spin about y. Shape (samples, bodies) each."""
    assert trace.across_velocity_m_s is not None
    assert trace.velocity_m_s is not None
    assert trace.spin_rad_s is not None
    return trace.across_velocity_m_s[:, :, 0], trace.velocity_m_s, trace.spin_rad_s[:, :, 1]


@pytest.mark.parametrize("engine", TUBE_CODES)
@pytest.mark.parametrize(
    ("degrees", "material"), [(5.0, "aluminium-oxide"), (20.0, "aluminium-alloy"), (60.0, "aluminium-oxide")]
)
def test_codes_rebound_by_their_laws(degrees: float, material: str, engine: str) -> None:
    need(engine)
    case, (normal, tangential) = case_at(degrees, f'chain.material="{material}"'), velocities(degrees)
    law = load_engine(engine).shear
    trace = compute(case, engine, limit_s=60.0).done
    (along, up, spin), right, *wrong = (
        [values[-1, 0] for values in motion_of(each)]
        for each in (trace, *(verlet_of(case, each) for each in (law, *({*LAWS} - {law}))))
    )
    assert abs(up - right[1]) < ROUNDED * SPEED_M_S
    assert abs(along - right[0]) < ROUNDED * SPEED_M_S
    assert abs(spin - right[2]) < ROUNDED * SPEED_M_S / case.chain.radius_m[0]
    assert up / normal == pytest.approx(RESTITUTION, abs=1e-5)  # error of the step; 1e-6 at 1 ns
    if degrees < 30:
        assert min(abs(along - other[0]) for other in wrong) > 1e-4 * SPEED_M_S
    else:  # it slides throughout: momentum alone gives the rebound, but a few of the first and last steps stick
        friction = case.scene.contact.friction
        assert along == pytest.approx(tangential - friction * (1 + RESTITUTION) * normal, rel=5e-5)
    assert trace.total_energy_J[-1] < trace.total_energy_J[0]


@pytest.mark.parametrize("law", LAWS)
def test_two_free_beads_keep_their_momenta(law: str) -> None:
    upper = '{from_wall=2, diameter="3 mm", velocity="-3 m/s", lateral_velocity="0.4 m/s"}'
    case = case_at(30.0, "wall=", "chain.count=2", f"chain.bead=[{upper}]", "contact.friction=0.3")
    trace = verlet_of(case, law)
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
@pytest.mark.parametrize(("law", "order", "factor"), [(TOTAL, 1.5, 1.0), (INCREMENTAL, 1.0, 5.0)])
def test_without_slip_the_contact_rebounds_in_closed_form(law: str, order: float, factor: float, steps: int) -> None:
    """A slow elastic impact, so that the overlap is much smaller than the radius, with practically infinite friction.

    The velocity of the contact (incremental law) or its displacement (total law) obeys ``u'' = -7/(2 m) shear
    sqrt(d(t)) u``. In ``(d/d_max)^(5/2)`` this is the hypergeometric equation, and both laws give
    ``cos(2 pi sqrt(1/400 + 7/10 shear/k))/cos(pi/10)``.
    """
    normal, tangential = 1e-6, 1e-7
    chain = tube_arrays_of(case_at(45.0).chain)
    slow, load = np.array([[tangential, 0.0, -normal]]), np.zeros(1)
    chain = replace(chain, velocity_m_s=slow, friction=1e6, damping=np.zeros(1), load_N=load)
    mass, stiffness, radius = chain.mass_kg[0], chain.stiffness[0], chain.radius_m[0]
    deepest_m = (1.25 * mass * normal**2 / stiffness) ** 0.4
    motion = integrate_tube(chain, 2.9432751 * deepest_m / normal / steps, steps + 10, 2, law)
    assert motion.force_N[-1, 0] == 0
    touching_m_s = motion.velocity_m_s[-1, 0, 0] - radius * motion.spin_rad_s[-1, 0, 1]
    expected = cos(2 * pi * sqrt(1 / 400 + 0.7 * chain.shear[0] / stiffness)) / cos(pi / 10)
    # The factors are at least 1.4 times the largest measured ones. The contact ends within a step, with the incremental
    # force still acting; the overlap enters through the arms.
    assert abs(touching_m_s / tangential - expected) < factor / steps**order + deepest_m / radius
