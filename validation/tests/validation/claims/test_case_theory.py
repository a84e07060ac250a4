"""Theories of the cases beyond the paper, against quadrature, each other and what they do not depend on."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import CubicSpline

from postproc.paper.simulate import exact
from postproc.read.signals import first_peak
from validation.claims.cases import MEASURES
from validation.claims.measures import passing_waves
from validation.claims.measures.impact import DURATION
from validation.reference.travelling_wave import solve_travelling_wave
from validation.tests.helpers.scenes import case_of


def test_the_constant_of_the_duration_is_that_of_quadrature() -> None:
    # x = 1 - y^2 takes the singularity away
    half, _ = quad(lambda y: 2 * y / math.sqrt(1 - (1 - y * y) ** 2.5) if y else 2 / math.sqrt(2.5), 0, 1, epsabs=1e-13)
    assert pytest.approx(2 * half, rel=1e-11) == DURATION
    assert round(DURATION, 5) == 2.94328  # as the literature has it


def test_hertz_impact_keeps_energy() -> None:
    case = case_of("two-spheres")
    given, chain = MEASURES["impact"].theory(case), case.chain
    speed, mass = 20.0, chain.mass_kg[0] / 2
    assert 0.4 * chain.stiffness[1] * given["peak_overlap_m"] ** 2.5 == pytest.approx(mass * speed**2 / 2, rel=1e-13)


def test_scipy_finds_the_closed_form_of_an_impact() -> None:
    ones = np.ones(2)
    time, force = passing_waves.forces(ones, np.array([0.0, 1.0]), np.zeros(2), np.array([0.0, 1.0]), 6.0)
    deepest = (5 * 0.5 / 4) ** 0.4
    peak = first_peak(time, force[:, 1])
    assert peak is not None
    assert peak.value == pytest.approx(deepest**1.5, rel=1e-8)
    assert peak.time_s == pytest.approx(DURATION * deepest / 2, rel=1e-6)


def test_what_scipy_says_does_not_depend_on_its_tolerance(monkeypatch: pytest.MonkeyPatch) -> None:
    case = case_of("wave-train")
    expected = MEASURES["train"].theory(case)
    monkeypatch.setattr(passing_waves, "TOLERANCE", 1e-12)
    assert MEASURES["train"].theory(case) == pytest.approx(expected, rel=1e-8)


def test_a_rigid_wall_is_a_mirror() -> None:
    """The wall's peak is that of two exact waves that meet at a contact, where each overlap counts twice."""
    wave, gap = solve_travelling_wave(), 14
    beads = np.arange(1.0, 2 * gap + 21)
    force, velocity = CubicSpline(wave.place, wave.force), CubicSpline(wave.place, wave.velocity)
    middle = len(beads) // 2 + 0.5  # a contact is half a bead below its bead
    overlap, speed = np.zeros(len(beads)), np.zeros(len(beads))
    for centre, sign in ((middle + gap, 1.0), (middle - gap, -1.0)):
        contact, bead = beads - 0.5 - centre, beads - centre
        overlap += np.where(abs(contact) < 4, np.cbrt(np.maximum(force(contact), 0)) ** 2, 0.0)
        speed += np.where(abs(bead) < 4, sign * velocity(bead), 0.0)
    stiffness = np.ones(len(beads))
    stiffness[0] = 0.0
    time, found = passing_waves.forces(np.ones(len(beads)), stiffness, overlap, speed, gap + 4.0)
    peak = first_peak(time, found[:, len(beads) // 2])
    assert peak is not None
    expected = MEASURES["wall"].theory(case_of("wall-reflection"))["wall_peak_over_incident"]
    assert peak.value / wave.force.max() == pytest.approx(expected, rel=1e-8)


def test_the_soft_wall_is_as_stiff_as_a_contact() -> None:
    stiffness = case_of("wall-reflection", "wall.material=soft-wall").chain.stiffness
    assert stiffness[0] == pytest.approx(stiffness[1], rel=1e-13)


def test_scipy_refuses_what_it_does_not_know() -> None:
    with pytest.raises(ValueError, match="loads"):
        passing_waves.forces_of(case_of("fig4").chain, 1e-4)


# ---- measures on what they cannot read


@pytest.mark.parametrize(
    ("measure", "scene", "settings", "expected"),
    [
        ("impact", "two-spheres", ("run.duration=20 us",), "do not meet and separate"),
        ("impact", "two-spheres", ("chain.bead.1.velocity=10 m/s",), "do not meet and separate"),
        ("train", "wave-train", ("run.duration=0.5 ms",), "waves at contact 21 within run.duration"),
        ("wall", "wall-reflection", ("run.duration=2 ms",), "within run.duration"),
        ("wall", "wall-reflection", ("striker.speed=1 nm/s",), "within run.duration"),
        ("solitary wave", "steel-chain", ("run.duration=0.1 ms",), "within run.duration"),
        ("solitary wave", "steel-chain", ("chain.sensors=[]",), "two sensors"),
    ],
)
def test_a_missing_wave_is_reported(measure: str, scene: str, settings: tuple[str, ...], expected: str) -> None:
    case = case_of(scene, *settings)
    with pytest.raises(ValueError, match=expected):
        MEASURES[measure].measure(case, exact(case).trace)
