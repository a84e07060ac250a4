"""Measures and theories of the cases beyond the paper, against quadrature, integrators and made-up signals."""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import CubicSpline

from drivers.chain.case import Case, build_case
from drivers.chain.chain import Array
from drivers.chain.contact_law import contact_stiffness
from drivers.chain.trace import Trace
from drivers.scene.read_scene import read_scene
from postproc.paper.simulate import exact
from postproc.read.signals import first_peak
from validation.claims.cases import MEASURES, pose, read_independent
from validation.claims.measures import bands, linear, passing_waves, weak
from validation.claims.measures.impact import DURATION
from validation.reference.travelling_wave import solve_travelling_wave
from validation.tests.helpers.scenes import case_of

CASES = {entry.id: entry for entry in read_independent()}
SMALL, WEAK, AT_CONTACT, AT_BEAD = (
    "linear-limit-1mN", "weak-strike-under-gravity", "head-on-at-contact", "head-on-at-bead"
)  # fmt: skip


@cache
def with_settings(name: str, *settings: str) -> Case:
    """The case of an entry with more settings."""
    entry = CASES[name]
    if entry.scene is None or not settings:
        return pose(entry)[0].case
    return build_case(read_scene(entry.scene, (*entry.set, *settings)))


@cache
def exact_trace(name: str, *settings: str) -> Trace:
    return exact(with_settings(name, *settings)).trace


def test_the_duration_of_an_impact_is_that_of_quadrature_and_of_scipy() -> None:
    # x = 1 - y^2 takes the singularity away
    half, _ = quad(lambda y: 2 * y / math.sqrt(1 - (1 - y * y) ** 2.5) if y else 2 / math.sqrt(2.5), 0, 1, epsabs=1e-13)
    assert pytest.approx(2 * half, rel=1e-11) == DURATION
    ones = np.ones(2)
    time, force = passing_waves.forces(ones, np.array([0.0, 1.0]), np.zeros(2), np.array([0.0, 1.0]), 6.0)
    deepest = (5 * 0.5 / 4) ** 0.4
    peak = first_peak(time, force[:, 1])
    assert peak is not None
    assert peak.value == pytest.approx(deepest**1.5, rel=1e-8)
    assert peak.time_s == pytest.approx(DURATION * deepest / 2, rel=1e-6)


def test_hertz_impact_keeps_energy() -> None:
    case = case_of("two-spheres")
    given, chain = MEASURES["impact"].theory(case), case.chain
    speed, mass = 20.0, chain.mass_kg[0] / 2
    assert 0.4 * chain.stiffness[1] * given["peak_overlap_m"] ** 2.5 == pytest.approx(mass * speed**2 / 2, rel=1e-13)


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
    time, forces = passing_waves.forces(np.ones(len(beads)), stiffness, overlap, speed, gap + 4.0)
    peak = first_peak(time, forces[:, len(beads) // 2])
    assert peak is not None
    expected = MEASURES["wall"].theory(case_of("wall-reflection"))["wall_peak_over_incident"]
    assert peak.value / wave.force.max() == pytest.approx(expected, rel=1e-8)


def linear_chain(spring: Array, mass: Array, velocity: Array, times: Array) -> tuple[Array, Array]:
    """Velocities and forces of springs and masses by scipy's integrator."""
    n = len(mass)

    def forces(place: Array) -> Array:
        return np.asarray(spring * -np.diff(place, prepend=0.0))

    def rates(_: float, state: Array) -> Array:
        force = forces(state[:n])
        return np.concatenate([state[n:], (force - np.append(force[1:], 0.0)) / mass])

    start = np.concatenate([np.zeros(n), velocity])
    solved = solve_ivp(rates, (0.0, times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-14)
    return solved.y[n:].T, np.array([forces(place) for place in solved.y[:n].T])


def test_small_motions_by_modes_are_those_of_springs_and_masses() -> None:
    case = case_of("deep-chain", "chain.count=12", "chain.bead=[{ from_wall = 12, velocity = '-5 um/s' }]")
    chain, times = case.chain, case.sample_times_s[:300]
    velocity, force = weak.motion_by_modes(chain, times, np.arange(12))
    unit, speed = chain.mass_kg[0], 5e-6
    spring = contact_stiffness(chain.stiffness, chain.overlap_m)
    rate = np.sqrt(spring[0] / unit)
    theirs = linear_chain(spring / spring[0], chain.mass_kg / unit, chain.velocity_m_s / speed, rate * times)
    assert velocity / speed == pytest.approx(theirs[0], abs=1e-9)
    assert force / (speed * np.sqrt(spring[0] * unit)) == pytest.approx(theirs[1], abs=1e-9)


def test_a_long_time_after_an_impurity_the_closed_form_has_passed() -> None:
    """A bead of twice the mass passes 1/(1 + |e|) with e = 1."""
    beads = "chain.bead=[{ from_wall = 500, mass = '8 g' }, { from_wall = 503, velocity = '-10 um/s' }]"
    case = with_settings("heavy-impurity", "chain.count=1000", "chain.origin=-5 m", beads, "run.duration=15 ms")
    assert MEASURES["impurity"].theory(case)["transmitted_share"] == pytest.approx(1 / 2, rel=1e-5)


def test_made_up_records_have_their_known_rates_lines_and_peaks() -> None:
    """A fit finds a rate from any start, a spectrum lines between its samples, a polynomial a peak in noise."""
    time, rate = np.arange(0.0, 100.0, 0.05), 1.0173
    record = 3.0 * linear.response(2, rate * time)
    fitted, amplitude, misfit = linear.fit(time, record, 2, linear.LAST_TAU)
    assert fitted == pytest.approx(rate, rel=1e-12)
    assert amplitude == pytest.approx(record.max(), rel=1e-3)
    assert misfit < 1e-12
    time, true = np.linspace(0.0, 0.04, 4000, endpoint=False), np.array([1234.5, 1467.8, 9876.54])
    signal = np.sin(2 * np.pi * np.outer(time, true) + np.array([0.3, 1.0, 2.0])) @ np.array([[1.0], [0.02], [0.01]])
    assert bands.lines_Hz(time, signal) == pytest.approx(true, rel=5e-6)
    time = np.arange(0.0, 15.0, 0.1)
    noise = 1e-4 * np.random.default_rng(1).normal(size=time.size)
    signal = np.exp(-((time - 4.03) ** 2) / 2) + 2 * np.exp(-((time - 12.0) ** 2) / 2)
    for disturbed, error in ((signal, 2e-5), (signal + noise, 2e-4)):
        peak = weak.leading_peak(time, disturbed)
        assert (peak.time_s, peak.value) == pytest.approx((4.03, 1.0), abs=error)


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("two-glass-spheres", ["run.duration=20 us"], "do not meet and separate"),
        ("train-2", ["run.duration=0.5 ms"], "waves at contact 21 within run.duration"),
        ("reflection-rigid", ["striker.speed=1 nm/s"], "within run.duration"),
        ("steel-chain", ["run.duration=0.1 ms"], "within run.duration"),
        (SMALL, ["run.duration=1 ms"], "too short"),
        (SMALL, ["chain.count=20", "chain.bead=[{ from_wall = 20, velocity = '-1 um/s' }]"], "the reflection arrives"),
        (AT_CONTACT, ["run.duration=2.5 ms"], "1 waves within the run"),
        ("cutoff-in-spectrum", ["run.duration=50 us"], "fewer than two lines"),
        ("precompressed-ptfe", ["chain.sensors=[{ from_wall = 40 }]"], "fewer than two sensors"),
        (WEAK, ["run.sample_interval=80 us", "run.time_step=2 us"], "run.sample_interval is too long"),
    ],
)
def test_a_run_that_does_not_show_the_wave_is_named(name: str, settings: Sequence[str], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        MEASURES[CASES[name].measure].measure(with_settings(name, *settings), exact_trace(name, *settings))


def test_a_run_without_state_is_named() -> None:
    with pytest.raises(ValueError, match="no state recorded"):
        weak.measure(with_settings(WEAK), replace(exact_trace(WEAK), velocity_m_s=None))


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("precompressed-ptfe", ["chain.bead=[{ from_wall = 9, mass = '1 g' }]"], "of unequal beads"),
        ("heavy-impurity", ["chain.bead=[{ from_wall = 70, velocity = '-1 um/s' }]"], "not one bead of another mass"),
        ("transfer-in-band", ["run.duration=4 ms"], "too short to separate"),
        ("transfer-in-band", ["drive.cycles=9"], "no sine force that lasts"),
        ("dimer-bands", ["chain.precompression="], "a contact without static load"),
        ("two-glass-spheres", ["gravity=9.81 m/s^2"], "loads"),
    ],
)
def test_a_theory_of_other_chains_is_refused(name: str, settings: Sequence[str], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        MEASURES[CASES[name].measure].theory(with_settings(name, *settings))
