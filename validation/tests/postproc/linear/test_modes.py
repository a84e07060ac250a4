"""Tests of linear modes, bands, sound speeds, and of the limits of linear theory."""

from math import pi

import numpy as np
import pytest

from drivers.chain.case import Case
from drivers.chain.chain import Array, arrays_of, contact_stiffness_at
from postproc.linear.modes import SOFTENING, bands_of, modes_of, sound_speed_m_s
from validation.reference.adaptive import integrate_adaptive
from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import case_of


def dimer(*settings: str) -> Case:
    """Dimer chain under one static force."""
    return case_of("dimer", "striker=", "gravity=", "chain.sensors=[]", "chain.precompression=5 N", *settings)


@pytest.mark.parametrize("place", [None, 4, 7])
def test_modes_are_the_eigenvalues_of_the_whole_matrix_without_a_bead_that_is_held(place: int | None) -> None:
    """The dense matrix of forces is that of finite differences of Hertz's law."""
    chain = dimer("chain.count=7").chain
    overlap, step = chain.overlap_m, 1e-7 * chain.overlap_m.min()

    def net_N(displacement: Array) -> Array:
        changed = overlap - np.diff(displacement, prepend=0.0)
        force = chain.stiffness * changed**1.5
        return np.asarray(force - np.append(force[1:], 0.0))

    columns = [(net_N(step * unit) - net_N(-step * unit)) / (2 * step) for unit in np.eye(7)]
    matrix = -np.column_stack(columns) / chain.mass_kg[:, np.newaxis]
    free = np.arange(1, 8) != place
    squared, vectors = np.linalg.eig(matrix[np.ix_(free, free)])
    order = np.argsort(squared.real)
    drive = f"drive={{form='sine', displacement='1 nm', frequency='1 kHz', from_wall={place}}}"
    modes = modes_of(dimer("chain.count=7", *([drive] if place else [])).chain)
    np.testing.assert_allclose(modes.frequency_Hz, np.sqrt(squared.real[order]) / (2 * pi), rtol=1e-7)
    assert not modes.shape[~free].any()
    for mode, column in enumerate(order):
        shape = vectors[:, column].real
        expected = shape / shape[np.argmax(np.abs(shape))]
        np.testing.assert_allclose(modes.shape[free, mode], expected, atol=1e-6)


def test_a_uniform_chain_has_the_textbook_dispersion() -> None:
    case = case_of("small-signal")
    chain, bands = case.chain, bands_of(case, case.chain.precompression_N)
    spring = contact_stiffness_at(float(chain.stiffness[-1]), chain.precompression_N)
    ratio = np.sqrt(spring / chain.mass_kg[-1])
    np.testing.assert_allclose(bands.frequency_Hz[:, 0], ratio / pi * np.sin(bands.phase / 2), rtol=1e-9, atol=1e-6)
    length = 2 * chain.radius_m[-1] - chain.overlap_m[-1]
    np.testing.assert_allclose(bands.group_velocity_m_s[:, 0], length * ratio * np.cos(bands.phase / 2), atol=1e-9)
    assert bands.sound_speed_m_s == pytest.approx(length * ratio, rel=1e-12)
    assert sound_speed_m_s(chain, 5, 30) == pytest.approx(bands.sound_speed_m_s, rel=1e-9)


def test_a_dimer_has_three_edges_and_group_velocities_that_are_slopes() -> None:
    case = dimer()
    chain, bands = case.chain, bands_of(case, 5.0)
    spring = contact_stiffness_at(float(chain.stiffness[5]), 5.0)
    heavy, light = chain.mass_kg[4], chain.mass_kg[5]
    (zero, acoustic), (optical, top) = bands.edges_Hz * 2 * pi
    assert zero == 0
    edges = np.sqrt(2 * spring * np.array([1 / heavy, 1 / light, 1 / heavy + 1 / light]))
    np.testing.assert_allclose([acoustic, optical, top], edges, rtol=1e-12)
    length = bands.group_velocity_m_s[0, 0] / (2 * pi * np.gradient(bands.frequency_Hz[:3, 0], bands.phase[:3])[0])
    slope = length * 2 * pi * np.gradient(bands.frequency_Hz, bands.phase, axis=0)
    np.testing.assert_allclose(bands.group_velocity_m_s[2:-2], slope[2:-2], atol=2e-3 * bands.sound_speed_m_s)
    assert sound_speed_m_s(chain, 3, 21, 2) == pytest.approx(bands.sound_speed_m_s, rel=1e-3)


def test_bands_are_read_from_ordinary_cells() -> None:
    plain = bands_of(dimer(), 5.0)
    odd = dimer("chain.bead=[{from_wall='2-4', mass='3 g'}]")
    np.testing.assert_array_equal(bands_of(odd, 5.0).frequency_Hz, plain.frequency_Hz)
    with pytest.raises(ValueError, match="tapered"):
        bands_of(case_of("tapered"), 1.0)
    with pytest.raises(ValueError, match="no cell"):
        bands_of(dimer("chain.bead=[{from_wall='1-38', mass='3 g'}]"), 5.0)


def test_a_contact_that_oscillates_is_slower_by_the_square_of_its_amplitude() -> None:
    """Period of a bead on the wall under a load, by the exact motion, from crossings of its static overlap."""
    settings = ("gravity=", "chain.count=1", "chain.sensors=[]", "chain.precompression=5 N", "striker=")
    chain, ratio = case_of("fig4", *settings).chain, 0.05
    frequency = float(modes_of(chain).frequency_Hz[0])
    speed = -2 * pi * frequency * ratio * chain.overlap_m[0]
    moving = type(arrays_of(chain))(chain.mass_kg, chain.stiffness, chain.overlap_m, np.array([speed]), chain.load_N)
    times = np.linspace(0, 10.5 / frequency, 4001)
    motion = integrate_adaptive(moving, times).displacement_m[:, 0]
    up = np.flatnonzero((motion[:-1] < 0) & (motion[1:] >= 0))
    crossings = times[up] - motion[up] * np.diff(times)[0] / (motion[up + 1] - motion[up])
    period = (crossings[-1] - crossings[0]) / (len(crossings) - 1)
    assert 1 - 1 / (period * frequency) == pytest.approx(SOFTENING * ratio**2, rel=0.05)


def test_the_command_says_where_linear_theory_ends_or_refuses_in_one_line() -> None:
    for settings, line in [
        (("small-signal",), "\nlinear: the motion of the scene changes"),
        (("low-amplitude",), "\nnot linear: the motion of the scene changes"),
        (("two-spheres",), "no linear waves"),
        (("fig4-tube",), "beads that move sideways"),
    ]:
        assert line in beads("modes", *settings).stdout
    wrong = beads("modes", "fig4", "--set", "chain.count=0", "--set", "chain.sensors=[]")
    assert (wrong.returncode, wrong.stderr.count("\n")) == (2, 1)
    assert "chain.count: found 0" in wrong.stderr
