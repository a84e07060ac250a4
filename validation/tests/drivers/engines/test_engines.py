"""The real engines against the same scheme and against the exact forces."""

from pathlib import Path

import numpy as np
import pytest

from postproc.read.observables import observe
from validation.accuracy.baseline import baseline_of
from validation.compare.departure import deviation
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import WALL, SceneWriter, case_of

ENGINES = ("liggghts", "yade")
GRAVITY = 'gravity = "9.81 m/s^2"'


def striker(**keys: str) -> str:
    return "[striker]\n" + "".join(f'{key} = "{value}"\n' for key, value in keys.items())


STEEL = {"material": "steel", "speed": "1 m/s"}
GLASS = '[materials.mine]\nyoungs_modulus = "20 GPa"\npoisson_ratio = 0.25\ndensity = "2.5 g/cm^3"\n'
SCENES: dict[str, dict[str, object]] = {
    "no bead": {"count": 0},
    "one bead": {"count": 1, "top": GRAVITY},
    "three beads, sensors in all": {"count": 3, "chain": "sensors = [{from_wall=1},{from_wall=3},{from_wall=2}]"},
    "60 beads": {"count": 60, "top": GRAVITY, "duration": "1 ms"},
    "rigid wall": {"wall": '[wall]\nmaterial = "rigid"'},
    "rigid wall, flat striker": {
        "top": GRAVITY,
        "wall": '[wall]\nmaterial = "rigid"',
        "striker": striker(shape="flat", mass="1 g", **STEEL),
    },
    "no wall": {"wall": "", "top": GRAVITY},
    "no wall, flat striker": {"wall": "", "striker": striker(shape="flat", mass="0.1 g", **STEEL)},
    "no striker": {"striker": "", "chain": 'bead = [{from_wall = 5, velocity = "-1 m/s"}]', "top": GRAVITY},
    "small striker": {"striker": striker(diameter="1 mm", material="steel", speed="3 m/s")},
    "large striker": {"striker": striker(diameter="20 mm", **STEEL), "top": GRAVITY},
    "precompression": {"chain": 'precompression = "2 N"'},
    "precompression without a wall": {"chain": 'precompression = "2 N"', "wall": ""},
    "gaps": {
        "top": GRAVITY,
        "duration": "1 ms",
        "chain": 'bead = [{from_wall=3, gap_below="20 um"}, {from_wall=1, gap_below="5 um", velocity="0.1 m/s"}]',
    },
    "unlike beads, far from the origin": {
        "top": GRAVITY + "\n" + GLASS,
        "chain": 'origin = "0.3 m"\n'
        'bead = [{from_wall=2, diameter="3 mm", material="mine"}, {from_wall=4, mass="1 g"}]',
    },
    "scattered masses": {"top": GRAVITY, "chain": 'mass_scatter = "0.0008 g"'},
    "soft beads": {"top": '[materials.ptfe]\nyoungs_modulus = "2 MPa"', "duration": "3 ms"},
    "nothing moves": {"top": GRAVITY, "striker": ""},
    "nothing presses": {"striker": ""},
}


@pytest.mark.parametrize("engine", ["liggghts", pytest.param("yade", marks=pytest.mark.long)])
@pytest.mark.parametrize("name", SCENES)
def test_scenes_that_nobody_prepared_for(name: str, engine: str, scene_file: SceneWriter, shared_runs: Path) -> None:
    case = case_of(scene_file("odd", **SCENES[name]))
    run, verlet = finished(case, engine, shared_runs), finished(case, "verlet", shared_runs)
    reference = finished(case, "reference", shared_runs)
    assert deviation(run.trace, verlet.trace).share <= 1e-9
    assert deviation(run.trace, reference.trace).share <= 1e-4


@pytest.mark.parametrize("engine", ENGINES)
def test_a_steel_chain(engine: str, scene_file: SceneWriter, shared_runs: Path) -> None:
    path = scene_file("steel", count=20, step="20 ns", striker=striker(diameter="10 mm", **STEEL), wall=WALL)
    settings = ("chain.material=steel", "chain.diameter=10 mm", "chain.mass=")
    case = case_of(path, *settings)
    run, verlet = finished(case, engine, shared_runs), finished(case, "verlet", shared_runs)
    found = deviation(run.trace, verlet.trace).share
    baseline = baseline_of(case)
    limit, samples = baseline.allowed, baseline.samples
    assert samples == case.scene.samples
    assert found <= limit.limit <= 1e-8


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("scene", ["fig4", "fig5", "fig6b", "fig6d"])
def test_the_papers_scenes_agree_with_the_same_scheme(scene: str, engine: str, shared_runs: Path) -> None:
    case = case_of(scene)
    run, verlet = finished(case, engine, shared_runs), finished(case, "verlet", shared_runs)
    assert deviation(run.trace, verlet.trace).share <= 1e-9


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("step", "limit"), [("0.1 us", 4e-5), ("0.01 us", 4e-7)])
def test_fig4_is_as_exact_as_its_step(step: str, limit: float, engine: str, shared_runs: Path) -> None:
    case = case_of("fig4", f"run.time_step={step}")
    run, exact = finished(case, engine, shared_runs), finished(case, "reference", shared_runs)
    assert deviation(run.trace, exact.trace).share <= limit


@pytest.mark.parametrize("engine", [*ENGINES, "reference"])
def test_fig4_reads_what_physics_says(engine: str, shared_runs: Path) -> None:
    run = finished(case_of("fig4"), engine, shared_runs)
    values = observe(run.layout, run.trace)
    assert values["bead_9_peak_N"] == pytest.approx(5.34, abs=0.005)
    assert values["bead_5_peak_N"] == pytest.approx(5.35, abs=0.005)
    assert values["wall_peak_N"] == pytest.approx(16.37, abs=0.005)
    assert values["energy_drift_J"] < 1e-5 * values["kinetic_energy_start_J"]
    assert values["impulse_imbalance_share"] < 1e-5


@pytest.mark.parametrize("engine", ENGINES)
def test_velocities_belong_to_the_time_of_the_forces(engine: str, shared_runs: Path) -> None:
    case = case_of("fig4", "run.record=['forces','state']")
    run, verlet = finished(case, engine, shared_runs), finished(case, "verlet", shared_runs)
    np.testing.assert_allclose(run.trace.kinetic_energy_J, verlet.trace.kinetic_energy_J, rtol=1e-7)
    assert (run.folder / "state.parquet").exists()
