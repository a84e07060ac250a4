"""Beads in a tube: equilibrium, bore contacts, records, and codes against the integrator."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from drivers.base.errors import InputError
from drivers.chain.chain import AT_REST, hertz_stiffness
from drivers.chain.lateral import conformity
from drivers.chain.schemes import verlet_of
from drivers.run.run import run_case
from postproc.read.observables import observe
from validation.accuracy.budget import budget_of
from validation.checks import PASS
from validation.tests.helpers.runs import TUBE_CODES, finished, need
from validation.tests.helpers.scenes import case_of

STATE = "run.record=['forces', 'state']"


@pytest.mark.parametrize("scene", ["fig4-tube", "fig6d-tube"])
def test_packed_beads_stay_at_rest_on_wall_and_bore(scene: str) -> None:
    case = case_of(scene, "striker=", "run.duration=50 us")
    chain, trace = case.chain, verlet_of(case)
    weight = case.scene.axial_gravity * chain.mass_kg.sum()
    assert trace.bore_N is not None
    assert trace.across_velocity_m_s is not None
    assert trace.velocity_m_s is not None
    assert trace.force_N[0, 0] == pytest.approx(weight, rel=10 * AT_REST)
    assert (trace.bore_N[0] > 0).all()
    speed = max(np.abs(trace.across_velocity_m_s).max(), np.abs(trace.velocity_m_s).max())
    assert speed < 100 * AT_REST * chain.beads * case.scene.axial_gravity * trace.time_s[-1]
    for force in (trace.force_N, trace.bore_N):
        assert np.abs(force - force[0]).max() < 1e-7 * weight


@pytest.mark.parametrize("scene", ["fig4-tube", "fig5-tube", "fig6b-tube", "fig6d-tube"])
def test_beads_start_in_a_plane_zigzag_for_each_seed(scene: str) -> None:
    cases = [case_of(scene, f"seed={seed}") for seed in range(3)]
    beads, azimuths = cases[0].chain.beads, set()
    first = np.linalg.norm(cases[0].chain.across_m[:beads], axis=1)
    for case in cases:
        offset, tube = case.chain.across_m, case.scene.tube
        assert tube is not None
        beside, play = offset[:beads], tube.inner_diameter / 2 - case.chain.radius_m
        off = np.linalg.norm(beside, axis=1)
        assert (beside[1:] * beside[:-1]).sum(axis=1) / off[1:] / off[:-1] == pytest.approx(-1, abs=1e-9)
        assert (off > play[:beads]).all()  # pressed into the bore
        assert (off < 1.02 * play[:beads]).all()
        assert np.hypot(*offset[-1]) <= max(play[-1], 0)  # a wide striker is on the axis
        # only the azimuth and the striker's position depend on the seed
        assert off == pytest.approx(first, rel=1e-8)
        azimuths.add(round(float(np.arctan2(offset[0, 1], offset[0, 0])), 3))
    assert len(azimuths) == len(cases)


def test_seeded_positions_are_limited_to_the_play() -> None:
    case = case_of("fig4-tube", "wall=", "gravity=", "chain.lateral_offset=0.12 mm")
    off, tube = np.hypot(*case.chain.across_m.T), case.scene.tube
    assert tube is not None
    assert (off <= (tube.inner_diameter / 2 - case.chain.radius_m) * (1 + 1e-12)).all()
    assert off.max() == pytest.approx(0.12e-3, rel=1e-9)
    assert off.min() < 0.11e-3


def test_a_chain_without_equilibrium_is_refused_with_its_worst_bead(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.chain.lateral.MAX_STEPS", 3)
    with pytest.raises(InputError, match=r"chain.lateral_offset: found no equilibrium: .* N are unbalanced on bead "):
        case_of("fig4-tube")


def elliptic(radius_m: float, bore_m: float) -> float:
    """Ratio of the contact stiffness in a bore to that on a flat, from Hertz's integrals over the potential.

    A force F on an ellipse of half axes a and b = e a makes ``overlap = c I(1, 1)/a`` and the curvatures
    ``(1/R - 1/Rb)/2 = c I(3, 1)/a^3`` and ``1/(2R) = c I(1, 3)/a^3`` with ``c = 3F/(4 pi E*)`` and ``I(p, q) =
    2 integral of (1 + t^2)^(-p/2) (e^2 + t^2)^(-q/2) dt`` from 0 to inf (Johnson, Contact Mechanics, section 4.2).
    """

    def integral(first: int, second: int, ratio: float) -> float:
        def inner(t: float) -> float:
            return float(2 * (1 + t * t) ** (-first / 2) * (ratio**2 + t * t) ** (-second / 2))

        return float(quad(inner, 0, 1, epsrel=1e-12)[0] + quad(inner, 1, np.inf, epsrel=1e-12)[0])

    across, along = (1 / radius_m - 1 / bore_m) / 2, 1 / radius_m / 2
    ratio: float = brentq(lambda e: integral(3, 1, e) / integral(1, 3, e) - across / along, 1e-4, 1, xtol=1e-14)
    return float(np.pi * np.sqrt(integral(3, 1, ratio) / across) / integral(1, 1, ratio) ** 1.5 / np.sqrt(radius_m))


def test_contact_with_the_bore_is_the_elliptic_one() -> None:
    """Of a bead in a bore 5 % wider it is 2.54 times as stiff as on a flat."""
    for radius, bore, ratio in ((2.38e-3, 2.5e-3, 2.54), (1.19e-3, 1.25e-3, 2.54), (1e-3, 1e4, 1)):
        assert elliptic(radius, bore) == pytest.approx(ratio, rel=2e-3)
        assert conformity(radius, bore) == pytest.approx(elliptic(radius, bore), rel=1e-8)
    case = case_of("fig4-tube")
    chain, ptfe, radius = case.chain, case.scene.materials["ptfe"], case.scene.chain.diameter / 2
    flat = hertz_stiffness(ptfe, radius, ptfe, np.inf)
    assert chain.bore_stiffness == pytest.approx(elliptic(radius, chain.bore_m) * flat, rel=1e-8)


SHORT_CHAIN = ("chain.count=6", "chain.sensors=[]", "run.duration=0.15 ms", STATE)
SCENES = {
    "different beads, a gap, velocities": (
        "chain.bead=[{from_wall=2, diameter='4.6 mm', velocity='0.5 m/s'}, {from_wall=3, material='steel', "
        "mass='0.3 g'}, {from_wall=5, mass='0.1 g', material='glass', gap_below='3 um', lateral_velocity='3 m/s'}]",
    ),
    "pressed, raised, damped, flat striker, rough bore": (
        "chain.precompression=5 N", "tube.friction=0.4", "chain.origin=1 m", "contact.restitution=0.9",
        "striker.shape=flat", "striker.diameter=", "tube.top=1.028 m", "contact.friction=0",
    ),
    "weightless, wide striker": (
        "gravity=", "wall.material=rigid", 'chain.lateral_offset="110 um"', "striker.diameter=6 mm",
        "striker.mass=0.2 g", "tube.top=29 mm",
    ),
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("name", SCENES)
def test_codes_agree_with_the_integrator(name: str, shared_runs: Path) -> None:
    case = case_of("fig4-tube", *SHORT_CHAIN, *SCENES[name])
    for engine in TUBE_CODES:
        run = finished(case, engine, shared_runs)
        assert {check.verdict for check in budget_of(case, engine, run.trace).checks} == {PASS}
        assert run.record.warnings == []
        assert run.trace.bore_N is not None
        assert run.trace.bore_N.max() > 0


def test_run_files_contain_sideways_motion_and_bore_forces(shared_runs: Path) -> None:
    case = case_of("fig4-tube", *SHORT_CHAIN, *SCENES["weightless, wide striker"])
    bodies = range(1, case.chain.bodies + 1)
    run = finished(case, "liggghts", shared_runs)
    forces, state = (pd.read_parquet(run.folder / f"{name}.parquet") for name in ("forces", "state"))
    names = [*(f"contact_{j}_N" for j in bodies), "bore_friction_N", *(f"bore_{j}_N" for j in bodies)]
    assert list(forces) == ["time_s", *names, "kinetic_energy_J", "total_energy_J", "momentum_N_s"]
    motion = [f"{axis}{name}" for name in ("m", "velocity_m_s") for axis in ("x_", "y_")]
    names = ["height_m", "velocity_m_s", *motion, *(f"spin_{axis}_rad_s" for axis in "xyz")]
    assert set(state) == {"time_s"} | {f"body_{j}_{name}" for j in bodies for name in names}
    assert not np.isnan(state.to_numpy()).any()
    momentum = state[[f"body_{j}_velocity_m_s" for j in bodies]].to_numpy() @ case.chain.mass_kg
    assert forces["momentum_N_s"].to_numpy() == pytest.approx(momentum, rel=1e-12)
    assert observe(run.layout, run.trace)["impulse_imbalance_share"] < 1e-4


def test_a_run_fails_if_the_striker_hits_the_tube(tmp_path: Path) -> None:
    need("liggghts")
    ended = run_case(case_of("fig6d-tube", "tube.top=43.1 mm"), "liggghts", tmp_path)
    assert not ended.done
    assert ended.record.reason.startswith("at t = ")
    assert "the striker comes down to the end of the tube" in ended.record.reason
