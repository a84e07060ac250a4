"""Tests of linear modes, bands, sound speeds, and of the limits of linear theory."""

from dataclasses import replace
from math import pi
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.chain.case import Case
from drivers.chain.chain import Array, arrays_of, contact_stiffness_at
from postproc.linear.modes import (
    SOFTENING,
    bands_at_loads,
    bands_of,
    edges_Hz,
    localised_modes,
    modes_of,
    sound_speed_m_s,
    springs_N_m,
)
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


def test_a_uniform_chain_has_the_textbook_dispersion_and_decay() -> None:
    case = case_of("small-signal")
    chain, bands = case.chain, bands_of(case, case.scene.chain.precompression)
    spring = contact_stiffness_at(float(chain.stiffness[-1]), case.scene.chain.precompression)
    ratio = np.sqrt(spring / chain.mass_kg[-1])
    band, above = bands[bands["band"] == 1], bands[bands["band"].isna()]
    np.testing.assert_allclose(band["frequency_Hz"], ratio / pi * np.sin(band["phase_rad"] / 2), rtol=1e-9, atol=1e-6)
    length = 2 * chain.radius_m[-1] - chain.overlap_m[-1]
    slope = length * ratio * np.cos(band["phase_rad"] / 2)
    np.testing.assert_allclose(band["group_velocity_m_s"], slope, atol=1e-9)
    assert band["group_velocity_m_s"][0] == pytest.approx(length * ratio, rel=1e-12)
    assert sound_speed_m_s(chain, 5, 30) == pytest.approx(length * ratio, rel=1e-9)
    decay = 2 * np.arccosh(np.maximum(above["frequency_Hz"] * pi / ratio, 1.0))
    np.testing.assert_allclose(above["decay_per_cell"], decay, atol=1e-6)  # a root at the edge
    assert above["frequency_Hz"].max() == pytest.approx(1.5 * ratio / pi)


def test_a_dimer_has_three_edges_and_group_velocities_that_are_slopes() -> None:
    case = dimer()
    chain, bands = case.chain, bands_of(case, 5.0)
    spring = contact_stiffness_at(float(chain.stiffness[5]), 5.0)
    heavy, light = chain.mass_kg[4], chain.mass_kg[5]
    (zero, acoustic), (optical, top) = edges_Hz(bands) * 2 * pi
    assert zero == 0
    edges = np.sqrt(2 * spring * np.array([1 / heavy, 1 / light, 1 / heavy + 1 / light]))
    np.testing.assert_allclose([acoustic, optical, top], edges, rtol=1e-12)
    rows, sound = bands.dropna().groupby("band"), bands["group_velocity_m_s"][0]
    frequency, group = (np.stack([band[name] for _, band in rows]) for name in ("frequency_Hz", "group_velocity_m_s"))
    slope = 2 * pi * np.gradient(frequency, bands["phase_rad"][: frequency.shape[1]], axis=1)
    np.testing.assert_allclose(group[:, 2:-2], (sound / slope[0, 0] * slope)[:, 2:-2], atol=2e-3 * sound)
    assert sound_speed_m_s(chain, 3, 21, 2) == pytest.approx(sound, rel=1e-3)


def test_the_decay_in_gaps_is_that_of_a_long_chain_that_is_driven() -> None:
    """Displacements ``(K - omega^2 M) u = f`` of 40 cells with a force on the top bead, far from both ends."""
    case = dimer("chain.count=80")
    chain, bands = case.chain, bands_of(case, 5.0)
    spring, mass = springs_N_m(chain), chain.mass_kg
    matrix = np.diag(spring + np.append(spring[1:], 0.0)) - np.diag(spring[1:], 1) - np.diag(spring[1:], -1)
    gaps = bands[bands["band"].isna() & (bands["decay_per_cell"] > 0.2)].iloc[::9]
    assert len(gaps) > 5
    for frequency, decay in gaps[["frequency_Hz", "decay_per_cell"]].to_numpy(float):
        u = np.linalg.solve(matrix - np.diag((2 * pi * frequency) ** 2 * mass), np.eye(80)[-1])
        assert np.log(np.abs(u[77] / u[75])) == pytest.approx(decay, rel=1e-6)


def test_bands_are_those_of_the_pattern_and_localised_modes_lie_in_gaps() -> None:
    plain = bands_of(dimer(), 5.0)
    odd = dimer("chain.bead=[{from_wall=20, mass='0.02 g'}]")
    for case in (odd, dimer("chain.mass_scatter=1 mg"), dimer("chain.bead=[{from_wall='1-38', mass='3 g'}]")):
        pd.testing.assert_frame_equal(bands_of(case, 5.0), plain)
    modes = modes_of(odd.chain)
    localised = localised_modes(modes, [plain])
    edges = edges_Hz(plain)
    gap = (modes.frequency_Hz > edges[0, 1]) & (modes.frequency_Hz < edges[1, 0])
    assert gap.sum() == 2
    assert localised[gap].all()
    assert localised.sum() < 6
    wide = replace(modes, participation=np.full(38, 9.0))
    assert localised_modes(wide, [plain])[gap].all()  # in a gap, however many beads move
    pressed = "chain.precompression=5 N"
    assert bands_at_loads(case_of("fig4", pressed))
    assert not bands_at_loads(case_of("tapered", pressed))


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


def test_the_command_prints_localised_modes_and_writes_two_tables(tmp_path: Path) -> None:
    light = ("--set", "chain.precompression=10 N", "--set", "chain.bead=[{from_wall=20, mass='0.02 g'}]")
    done = beads("modes", "dimer", *light, "--results", tmp_path)
    assert "\nmode 19: " in done.stdout
    assert "\nmode 15: " not in done.stdout
    modes, bands = (pd.read_csv(tmp_path / f"modes-dimer{end}.csv") for end in ("", "-bands"))
    assert len(modes) == 38
    assert bands["decay_per_cell"].max() > 1


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
