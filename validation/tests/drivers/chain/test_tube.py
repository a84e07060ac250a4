"""Beads in a tube on LIGGGHTS and YADE: starts, bore contacts, records, and agreement with the integrator."""

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from drivers.base.errors import InputError
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.chain import AT_REST, Array
from drivers.chain.contact_law import conformity, hertz_stiffness
from drivers.chain.lateral_start import find_rest, with_lateral
from drivers.run.run import run_case
from drivers.run.run_folder import EndedRun
from postproc.draw.film import film_of, sheet
from postproc.draw.product import write_product
from postproc.draw.scene_drawing import draw_scene
from postproc.draw.vtk import write_series
from postproc.read.observables import observe
from validation.accuracy.budget import budget_of
from validation.checks import PASS
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import case_of

pytestmark = pytest.mark.long

CODES = ("liggghts", "yade")
TWINS = ("fig4-tube", "fig5-tube", "fig6b-tube", "fig6d-tube")
STATE = 'run.record=["forces","state"]'
FIRST_STEPS = ('run.sample_interval="0.1 us"', 'run.duration="0.2 us"', STATE)
FRICTIONLESS = ("contact.friction=0", "tube.friction=0")
ROUNDING_SHARE = 1e-9  # over the largest force, as the tolerance model.force
IMPULSE_LIMIT = 1e-4  # over the largest momentum: the impulse is integrated from samples


def state_of(run: EndedRun, name: str) -> Array:
    """Columns of the state file, such as ``x_m``. Shape (samples, bodies)."""
    table = pd.read_parquet(run.folder / "state.parquet")
    return table[[f"body_{j}_{name}" for j in range(1, run.record.bodies + 1)]].to_numpy()


def bore_of(run: EndedRun) -> Array:
    """Forces of the bore. Shape (samples, bodies)."""
    table = pd.read_parquet(run.folder / "forces.parquet")
    return table[[f"bore_{j}_N" for j in range(1, run.record.bodies + 1)]].to_numpy()


def offsets_of(case: Case) -> Array:
    assert case.chain.lateral is not None
    return case.chain.lateral.offset_m[: case.chain.beads]


@pytest.mark.parametrize("scene", TWINS)
def test_codes_start_at_the_same_rest(scene: str, shared_runs: Path) -> None:
    case = case_of(scene, *FIRST_STEPS)
    chain, beads = case.chain, case.chain.beads
    weight = chain.gravity_m_s2 * chain.mass_kg[:beads].sum()
    places, bores = [], []
    for engine in CODES:
        run = finished(case, engine, shared_runs)
        force, bore = run.trace.force_N[0], bore_of(run)[0]
        assert force[0] == pytest.approx(weight, rel=10 * AT_REST)
        place = np.stack([state_of(run, name) for name in ("x_m", "y_m", "height_m")], axis=2)[0]
        # forces of the code across the axis: contacts push along the line of centres, the bore towards the axis
        along = np.diff(place[:beads], axis=0)
        push = force[1:beads, np.newaxis] * along[:, :2] / along[:, 2:]
        radial = place[:beads, :2] / np.linalg.norm(place[:beads, :2], axis=1)[:, np.newaxis]
        left = -bore[:beads, np.newaxis] * radial
        left[1:] += push
        left[:-1] -= push
        assert np.abs(left).max() < 100 * AT_REST * weight
        # after one step only the struck bead and the striker have moved
        for name in ("x_velocity_m_s", "y_velocity_m_s", "velocity_m_s"):
            moved = np.abs(state_of(run, name)[1, : beads - 1])
            assert moved.max() < 100 * AT_REST * beads * chain.gravity_m_s2 * case.scene.time_step_s
        places.append(place)
        bores.append(bore)
    assert np.abs(places[0] - places[1]).max() < 1e-14 + 1e-12 * (10.0 if np.isinf(chain.radius_m[-1]) else 0.0)
    assert np.abs(bores[0] - bores[1]).max() < 1e-7 * bores[0].max()


@pytest.mark.parametrize("scene", TWINS)
def test_beads_start_in_a_plane_zigzag_for_each_seed(scene: str) -> None:
    cases = [case_of(scene, f"seed={seed}") for seed in range(4)]
    first, azimuths = cases[0], set()
    for case in cases:
        offset = offsets_of(case)
        off = np.linalg.norm(offset, axis=1)
        cosine = (offset[1:] * offset[:-1]).sum(axis=1) / off[1:] / off[:-1]
        assert cosine == pytest.approx(-1, abs=1e-9)
        play = case.scene.tube.inner_diameter / 2 - case.chain.radius_m[: case.chain.beads] if case.scene.tube else 0
        assert (off > play).all()  # pressed into the bore
        assert (off < 1.02 * play).all()
        # only the azimuth and the striker's position depend on the seed
        assert off == pytest.approx(np.linalg.norm(offsets_of(first), axis=1), rel=1e-8)
        assert case.chain.overlap_m[:-1] == pytest.approx(first.chain.overlap_m[:-1], rel=1e-6)
        for name in ("mass_kg", "radius_m", "stiffness", "velocity_m_s", "load_N"):
            np.testing.assert_array_equal(getattr(case.chain, name), getattr(first.chain, name))
        azimuths.add(round(float(np.arctan2(offset[0, 1], offset[0, 0])), 3))
    assert len(azimuths) == len(cases)


def test_seeded_positions_of_the_striker_are_within_the_play() -> None:
    places = []
    for seed in range(4):
        case = case_of("fig6b-tube", f"seed={seed}", 'chain.lateral_offset="60 um"')
        assert case.chain.lateral is not None
        places.append(case.chain.lateral.offset_m[-1])
        assert np.hypot(*places[-1]) <= 0.25e-3 * (1 + 1e-12)
    assert len({tuple(place) for place in places}) == 4
    for wide in ("fig5-tube", "fig6d-tube"):  # a striker wider than the bore starts above the tube, on the axis
        lateral = case_of(wide).chain.lateral
        assert lateral is not None
        assert not lateral.offset_m[-1].any()


@pytest.mark.parametrize("engine", CODES)
@pytest.mark.parametrize("scene", ["fig4", "fig5"])
def test_without_offset_forces_are_those_of_the_straight_chain(scene: str, engine: str, shared_runs: Path) -> None:
    short = 'run.duration="0.1 ms"'
    straight = finished(case_of(scene, short), engine, shared_runs).trace
    top = ("tube.top=52 mm",) if scene == "fig5" else ()
    free = case_of(scene, short, "chain.lateral_offset=0 um", "tube.friction=0.05", "contact.friction=0.05", *top)
    assert free.chain.lateral is not None
    found = finished(free, engine, shared_runs)
    limit = tolerance("elements", "nothing").limit if scene == "fig5" else ROUNDING_SHARE
    assert np.abs(found.trace.force_N - straight.force_N).max() < limit * straight.force_N.max()
    assert not bore_of(found).any()


@cache
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


def test_a_bore_contact_is_2_54_times_as_stiff_as_a_flat() -> None:
    for radius, bore in ((2.38e-3, 2.5e-3), (1.19e-3, 1.25e-3), (1e-3, 5e-3)):
        assert conformity(radius, bore) == pytest.approx(elliptic(radius, bore), rel=1e-8)
    assert elliptic(2.38e-3, 2.5e-3) == pytest.approx(2.54, abs=5e-3)
    assert elliptic(1.19e-3, 1.25e-3) == pytest.approx(2.54, abs=5e-3)
    assert elliptic(1e-3, 1e4) == pytest.approx(1, rel=1e-6)  # a very wide bore is a flat


@pytest.mark.parametrize("engine", CODES)
@pytest.mark.parametrize("scene", ["fig4-tube", "fig6b-tube"])
def test_contact_with_the_bore_is_the_elliptic_one(scene: str, engine: str, shared_runs: Path) -> None:
    case = case_of(
        scene, "chain.count=1", "chain.sensors=[]", "chain.lateral_offset=", "striker=", "wall=", "gravity=",
        *FRICTIONLESS, "chain.bead=[{from_wall=1, lateral_velocity='1 m/s'}]", 'run.duration="0.3 ms"',
        'run.time_step="20 ns"', STATE,
    )  # fmt: skip
    run = finished(case, engine, shared_runs)
    assert case.scene.tube is not None
    radius, bore = case.scene.chain.diameter / 2, case.scene.tube.inner_diameter / 2
    ptfe = case.scene.materials["ptfe"]
    expected = elliptic(radius, bore) * hertz_stiffness(ptfe, radius, ptfe, np.inf)
    overlap = np.maximum(np.abs(state_of(run, "x_m")[:, 0]) + radius - bore, 0.0)
    force = bore_of(run)[:, 0]
    assert (overlap > 0).sum() > 20
    assert np.abs(force - expected * overlap**1.5).max() < 1e-8 * force.max()
    # at the largest overlap the contact has all the energy
    energy = 0.5 * case.chain.mass_kg[0]
    assert force.max() == pytest.approx(expected * (2.5 * energy / expected) ** 0.6, rel=1e-3)
    assert np.abs(run.trace.total_energy_J / energy - 1).max() < 1e-4
    assert np.abs(state_of(run, "y_m")).max() < 1e-15
    assert np.abs(state_of(run, "height_m") - case.chain.height_m).max() < 1e-15


SHORT_CHAIN = ("chain.count=6", "chain.sensors=[]", 'run.duration="0.15 ms"')
SCENES = {
    "different beads and a gap": (
        "chain.bead=[{from_wall=2, diameter='4.6 mm'}, {from_wall=3, material='steel', mass='0.3 g'}, "
        "{from_wall=5, diameter='4.7 mm', mass='0.1 g', material='glass', gap_below='3 um'}]",
    ),
    "beads with velocities": (
        "chain.bead=[{from_wall=2, velocity='0.5 m/s'}, {from_wall=4, lateral_velocity='3 m/s', velocity='-1 m/s'}]",
    ),
    "pressed, raised, damped": (
        "chain.precompression=5 N", "tube.friction=0.3", "chain.origin=1 m", "contact.restitution=0.9",
    ),
    "free, narrow striker": ("wall=", "gravity=", "striker.diameter=4.2 mm", 'chain.lateral_offset="110 um"'),
    "weightless, wide striker": (
        "gravity=", "wall.material=rigid", 'chain.lateral_offset="110 um"', "striker.diameter=6 mm",
        "striker.mass=0.2 g", "tube.top=29 mm",
    ),
    "flat striker, rough bore": (
        "striker.shape=flat", "striker.diameter=", "tube.top=28 mm", "contact.friction=0", "tube.friction=0.4",
    ),
    "no striker, friction between beads": (
        "striker=", "chain.bead=[{from_wall=3, lateral_velocity='1 m/s'}]", "contact.friction=0.4", "tube.friction=0",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_codes_agree_with_the_integrator(name: str, shared_runs: Path) -> None:
    case = case_of("fig4-tube", *SHORT_CHAIN, *SCENES[name])
    runs = {engine: finished(case, engine, shared_runs) for engine in (*CODES, "verlet")}
    checks = [check for engine, run in runs.items() for check in budget_of(case, engine, run.trace).checks]
    assert {check.verdict for check in checks} == {PASS}
    assert {check.engine for check in checks if check.quantity == "model: force"} >= set(CODES)
    assert [run.record.warnings for run in runs.values()] == [[]] * 3
    assert bore_of(runs["yade"]).max() > 0


@pytest.mark.parametrize("engine", CODES)
def test_beads_without_loads_stay_at_rest(engine: str, shared_runs: Path) -> None:
    case = case_of("fig4-tube", *SHORT_CHAIN, "wall=", "gravity=", "striker=", 'run.duration="20 us"')
    run = finished(case, engine, shared_runs)
    assert run.trace.kinetic_energy_J.max() < 1e-25
    assert run.trace.force_N.max() < 1e-12


@pytest.mark.parametrize("engine", CODES)
def test_a_bead_may_leave_a_chain_without_tube(engine: str, shared_runs: Path) -> None:
    flies = "chain.bead=[{from_wall=3, lateral_velocity='50 m/s'}]"
    case = case_of("fig4-tube", *SHORT_CHAIN, "tube=", "chain.lateral_offset=", flies, 'run.duration="1 ms"', STATE)
    run = finished(case, engine, shared_runs)
    assert 0.04 < state_of(run, "x_m")[-1, 2] < 0.05
    assert not run.record.warnings


def test_a_study_over_seeds(tmp_path: Path) -> None:
    study = tmp_path / "seeds.toml"
    settings = '[set]\n"run.duration" = "20 us"\n[[axis]]\nkey = "seed"\nvalues = [1, 2, 3]\n'
    study.write_text(f'scene = "fig4-tube"\nengines = ["liggghts", "verlet"]\n{settings}')
    where = ("--runs", tmp_path / "runs", "--results", tmp_path / "results")
    done = beads("batch", study, *where)
    assert done.returncode == 0, done.stderr
    table = pd.read_parquet(tmp_path / "results" / "seeds.parquet")
    assert list(table["status"]) == ["done"] * 6
    assert table["force_error_share"].isna().all()  # no exact motion in three dimensions
    study.write_text(f'scene = "fig4-tube"\nengines = ["reference"]\n{settings}')
    refused = beads("batch", study, *where)
    assert refused.returncode == 2
    assert "lateral freedom, tube, friction, rotation" in refused.stderr
    assert len(refused.stderr.strip().splitlines()) == 1


def test_run_files_contain_sideways_motion_and_bore_forces(shared_runs: Path, tmp_path: Path) -> None:
    case = case_of("fig4-tube", *SHORT_CHAIN, *SCENES["weightless, wide striker"], STATE)
    bodies = case.chain.bodies
    for engine in CODES:
        run = finished(case, engine, shared_runs)
        forces, state = (pd.read_parquet(run.folder / f"{name}.parquet") for name in ("forces", "state"))
        expected = [*(f"contact_{j}_N" for j in range(1, bodies + 1)), "bore_friction_N"]
        expected += [f"bore_{j}_N" for j in range(1, bodies + 1)]
        assert list(forces) == ["time_s", *expected, "kinetic_energy_J", "total_energy_J", "momentum_N_s"]
        names = ["height_m", "velocity_m_s", "x_m", "x_velocity_m_s", "y_m", "y_velocity_m_s"]
        names += [f"spin_{axis}_rad_s" for axis in "xyz"]
        assert set(state) == {"time_s"} | {f"body_{j}_{name}" for j in range(1, bodies + 1) for name in names}
        assert not np.isnan(state.to_numpy()).any()
        assert not forces[f"bore_{bodies}_N"].any()  # the striker stays above the tube
        vertical = state[[f"body_{j}_velocity_m_s" for j in range(1, bodies + 1)]].to_numpy()
        assert forces["momentum_N_s"].to_numpy() == pytest.approx(vertical @ case.chain.mass_kg, rel=1e-12)
    assert len(write_series(run, tmp_path / "vtk", 2)) == 2
    film = film_of(run, 3)
    assert film.place_m[0, :, 0] == pytest.approx(state_of(run, "x_m")[0], abs=1e-15)
    assert write_product(sheet(film, "a tube"), "film", tmp_path)
    assert draw_scene(case.scene, case.chain)
    values = observe(run.layout, run.trace)
    assert values["impulse_imbalance_share"] < IMPULSE_LIMIT
    assert values["momentum_start_N_s"] == pytest.approx(-0.2e-3 * 2, rel=1e-9)


def test_messages_name_beads_without_equilibrium(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.chain.lateral_start.MAX_STEPS", 3)
    with pytest.raises(InputError) as caught:
        case_of("fig4-tube")
    key, message = str(caught.value).split(": found ")
    assert "chain.lateral_offset" in key
    assert "no equilibrium" in message
    assert " N are unbalanced on bead " in message


def test_an_equilibrium_is_found_again_from_itself() -> None:
    case = case_of("fig6d-tube")
    chain, beads = case.chain, case.chain.beads
    lateral = chain.lateral
    assert lateral is not None
    assert lateral.bore is not None
    assert with_lateral(case.scene, chain).height_m == pytest.approx(chain.height_m, rel=1e-12)
    place = np.column_stack([lateral.offset_m, chain.height_m - chain.wall_height_m])[:beads]
    rest, left = find_rest(chain, place)
    assert left.max() <= AT_REST * np.abs(chain.load_N[:beads]).sum()
    assert np.abs(rest - place).max() < 1e-12
    assert chain.force_N[0] == pytest.approx(-chain.load_N[:beads].sum(), rel=10 * AT_REST)


def test_a_run_fails_if_the_striker_hits_the_tube(tmp_path: Path) -> None:
    ended = run_case(case_of("fig6d-tube", "tube.top=43.1 mm"), "liggghts", tmp_path)
    assert not ended.done
    assert ended.record.reason.startswith("at t = ")
    assert "the striker comes down to the end of the tube" in ended.record.reason
