"""Diagnoses of motions with one fault, made in memory; good motions have none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.chain.case import Case
from drivers.chain.chain import Array, arrays_of
from drivers.chain.schemes import verlet_in_heights, verlet_of
from drivers.chain.trace import Trace, make_trace
from drivers.engines import codes
from drivers.run.finished import EndedRun
from validation.accuracy.baseline import baseline_of, comparable
from validation.compare.comparison import compare_case
from validation.compare.diagnosis import FORCES_MATCH, WINDOW, Diagnosis, Found, diagnose, diagnoses_of
from validation.compare.variants import model_of
from validation.compare.verdict import FAIL, NOT_RUN, PASS
from validation.reference.hertz_chain import Motion
from validation.stability.measured_limits import random_case
from validation.tests.helpers.runs import finished
from validation.tests.helpers.sabotage_in_memory import SABOTAGES, softer_wall, trace_with
from validation.tests.helpers.scenes import SceneWriter, case_of

QUICK, ALL = 6, 36
SHIPPED = ("fig4", "fig5", "fig6b", "fig6d", "low-amplitude")
GRAVITY = 'gravity = "9.81 m/s^2"'
FLAT_AND_LOSSY = """title = "one bead under a flat face, lossy"
gravity = "9.81 m/s^2"
chain = { count = 1, material = "ptfe", diameter = "4.76 mm" }
striker = { shape = "flat", material = "alumina", mass = "2 g", speed = "0.44 m/s" }
wall = { material = "rigid" }
contact = { restitution = 0.6 }
run = { duration = "0.2 ms", sample_interval = "1 us", time_step = "20 ns" }
"""
CLOSELY = 1e-8  # of the largest change, where rounding does not take more: measured up to 1e-9


@pytest.mark.parametrize("number", [pytest.param(n, marks=() if n < QUICK else pytest.mark.long) for n in range(ALL)])
def test_one_fault_in_a_random_scene_is_named(number: int) -> None:
    case, draw = random_case(number, accuracy=1e-3), np.random.default_rng(number)
    for place in draw.permutation(len(SABOTAGES)):  # the first that applies to the scene
        changed = SABOTAGES[place](case, draw)
        if changed is not None:
            break
    assert changed is not None
    chain, kind = changed
    diagnosis = diagnose(case, "yade", trace_with(case, chain))
    assert diagnosis is not None
    assert (diagnosis.kind, diagnosis.matched) == (kind, True), diagnosis.sentence
    assert diagnosis.left <= CLOSELY or "the horizon" in diagnosis.sentence or diagnosis.left < 1e-5
    assert diagnosis.deviation > 10 * diagnosis.left


@pytest.mark.parametrize("scene", SHIPPED)
def test_good_runs_match_nothing(scene: str) -> None:
    case = case_of(scene)
    assert diagnose(case, "verlet", verlet_of(case)) is None
    assert diagnose(case, "liggghts", verlet_in_heights(case)) is None


@pytest.mark.parametrize("engine", codes())
def test_good_runs_of_the_codes_match_nothing(engine: str, shared_runs: Path) -> None:
    case = case_of("fig5")
    assert diagnose(case, engine, finished(case, engine, shared_runs).trace) is None


def test_chaos_is_not_explained() -> None:
    case = case_of("fig4", "run.duration=20 ms", "run.time_step=0.5 us")
    rounded = verlet_in_heights(case)
    assert np.abs(rounded.force_N - verlet_of(case).force_N).max() > 1e-6 * rounded.force_N.max()
    assert diagnose(case, "verlet", rounded) is None


def test_two_faults_match_no_variant(scene_file: SceneWriter) -> None:
    case = case_of(scene_file(top=GRAVITY))
    chain = arrays_of(case.chain)
    stiffness, mass = chain.stiffness.copy(), chain.mass_kg.copy()
    stiffness[0] *= 0.7
    mass[3] *= 1.2
    said = diagnose(case, "yade", trace_with(case, replace(chain, stiffness=stiffness, mass_kg=mass)))
    assert said is not None
    assert not said.matched
    assert said.sentence.startswith("no variant explains the deviation of ")


def recorded(case: Case, motion: Motion, **changes: np.ndarray) -> Trace:
    """Trace of a motion with some columns replaced."""
    values = {"force": motion.force_N, "velocity": motion.velocity_m_s} | changes
    height = case.chain.height_m + motion.displacement_m
    return make_trace(case.chain, case.sample_times_s, values["force"], height, values["velocity"])


def half_step(case: Case, motion: Motion) -> Array:
    """Changes of velocities in half a time step. Shape (samples, bodies)."""
    above = np.hstack([motion.force_N[:, 1:], np.zeros((len(motion.force_N), 1))])
    acceleration = (motion.force_N - above + case.chain.load_N) / case.chain.mass_kg
    return np.asarray(0.5 * case.scene.time_step_s * acceleration)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ("sign", "matches forces of the other sign "),
        ("order", "matches contacts in the opposite order "),
        ("sample", "matches forces stamped 1 sample early "),
        ("loads", "matches forces summed without the loads "),
        ("factor", "matches forces times 1000 "),
    ],
)
def test_misread_forces_are_named(changed: str, sentence: str, scene_file: SceneWriter) -> None:
    case = case_of(scene_file(top=GRAVITY))
    model, samples = model_of(case), case.scene.samples
    right = model.motion(samples)
    force, summed = right.force_N, -np.append(0, np.cumsum(case.chain.load_N)[:-1])
    made = {
        "sign": {"force": -force},
        "order": {"force": force[:, ::-1]},
        "sample": {"force": model.motion(samples + 1).force_N[1:]},
        "loads": {"force": force + summed},
        "factor": {"force": 1000 * force},
    }[changed]
    said = diagnose(case, "yade", recorded(case, right, **made))
    assert said is not None
    assert said.sentence.startswith(sentence), said.sentence


@pytest.mark.parametrize(("sign", "when"), [(1, "early"), (-1, "late")])
def test_velocities_half_a_step_off_are_red_and_named(
    sign: int, when: str, scene_file: SceneWriter, shared_runs: Path
) -> None:
    """Wrong recorded velocities change no force."""
    case = case_of(scene_file())
    run = finished(case, "verlet", shared_runs)
    motion = model_of(case).motion(case.scene.samples)
    odd = with_trace(run, recorded(case, motion, velocity=motion.velocity_m_s + sign * half_step(case, motion)))
    verdicts = {verdict.quantity: verdict for verdict in compare_case(case, {"verlet": run, "yade": odd}, {})
                if verdict.engine == "yade"}  # fmt: skip
    assert verdicts["force against verlet"].verdict == PASS
    assert verdicts["motion against verlet"].verdict == FAIL
    said = diagnoses_of(case, verdicts.values(), {"yade": odd.trace})
    assert said["yade"] == f"matches velocities half a step (0.05 µs) {when} bit for bit"


def with_trace(run: EndedRun, trace: Trace) -> EndedRun:
    """Copy of a run with another trace than that in its folder."""
    other = EndedRun(run.folder, run.record)
    other.__dict__["trace"] = trace
    return other


def test_only_red_rows_are_diagnosed(scene_file: SceneWriter) -> None:
    case = case_of(scene_file(top=GRAVITY))
    good = verlet_of(case)
    chain, _ = softer_wall(case, np.random.default_rng(0)) or (None, "")
    assert chain is not None
    verdicts = compare_case(case, {}, {"yade": "failed: something", "liggghts": "not installed", "verlet": "failed: x"})
    assert {verdict.engine: verdict.verdict for verdict in verdicts} == {
        "yade": FAIL, "liggghts": NOT_RUN, "verlet": FAIL,
    }  # fmt: skip
    said = diagnoses_of(case, verdicts, {"yade": trace_with(case, chain), "liggghts": good, "verlet": good})
    assert set(said) == {"yade", "verlet"}
    assert said["yade"].startswith("matches a wall contact ")
    assert said["verlet"] == FORCES_MATCH


def test_reasons_for_no_diagnosis(scene_file: SceneWriter) -> None:
    sideways = case_of("oblique-impact")
    case = case_of(scene_file(top=GRAVITY))
    broken = verlet_of(case)
    force = broken.force_N.copy()
    force[100:] = np.nan
    for said, words in (
        (diagnose(sideways, "yade", verlet_of(case)), "no diagnosis: only straight chains have variants"),
        (
            diagnose(case, "yade", replace(broken, force_N=force)),
            "no diagnosis: the run matches its scene until 100 µs, ",
        ),
        (
            diagnose(case, "yade", replace(broken, force_N=force[:50])),
            "no diagnosis: the run matches its scene until 50 µs, ",
        ),
        (diagnose(case, "yade", replace(broken, force_N=np.nan * force)), "no diagnosis: there are no forces to "),
    ):
        assert isinstance(said, Diagnosis)
        assert not said.matched
        assert said.sentence.startswith(words)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_one_sample_that_fits_is_no_match(factor: float, tmp_path: Path) -> None:
    """For damped beads that just touch, rounding is large from the start: such a variant fits the sample at time 0."""
    (tmp_path / "flat.toml").write_text(FLAT_AND_LOSSY)
    case = case_of(tmp_path / "flat.toml")
    chain = arrays_of(case.chain)
    assert chain.damping is not None
    said = diagnose(case, "yade", trace_with(case, replace(chain, damping=factor * chain.damping)))
    assert said is not None
    ratio = f"{factor * case.chain.damping_ratio:.6g}"
    assert said.sentence.startswith(f"matches contacts of damping ratio {ratio}, without attraction "), said.sentence
    assert said.left <= CLOSELY


@pytest.mark.parametrize("who", ["all materials", "ptfe", "brass"])
@pytest.mark.parametrize(
    ("forgotten", "words"),
    [
        ("poisson_ratio=0.25", "Poisson's ratio of 0.25"),
        ("youngs_modulus=1 GPa", "Young's modulus of 1 GPa"),
        ("poisson_ratio=0.25 youngs_modulus=1 GPa", "Young's modulus of 1 GPa and Poisson's ratio of 0.25"),
    ],
)
def test_default_elastic_constants_of_yade_are_named(
    who: str, forgotten: str, words: str, scene_file: SceneWriter
) -> None:
    scene = scene_file(top=GRAVITY)
    names = ["ptfe", "brass"] if who == "all materials" else [who]
    constants = [f"{key}={value}" for key, value in (("poisson_ratio", "0.25"), ("youngs_modulus", "1 GPa"))
                 if key in forgotten]  # fmt: skip
    other = case_of(scene, *(f"materials.{name}.{constant}" for name in names for constant in constants))
    case = case_of(scene)
    chain = replace(arrays_of(case.chain), stiffness=other.chain.stiffness)
    said = diagnose(case, "yade", trace_with(case, chain))
    assert said is not None
    assert said.sentence == f"matches {who} with YADE's default {words} bit for bit"
    assert said.left <= CLOSELY


def test_a_rigid_wall_may_have_the_default_modulus(scene_file: SceneWriter) -> None:
    """Its Poisson's ratio is 0, so in YADE its compliance is 1/E."""
    case = case_of(scene_file(top=GRAVITY), "wall.material=rigid")
    soft = 'materials.soft={ youngs_modulus = "1 GPa", poisson_ratio = 0.0 }'
    other = case_of(scene_file(top=GRAVITY), soft, "wall.material=soft")
    chain = replace(arrays_of(case.chain), stiffness=other.chain.stiffness)
    said = diagnose(case, "yade", trace_with(case, chain))
    assert said is not None
    assert said.sentence.startswith("matches rigid with YADE's default Young's modulus of 1 GPa "), said.sentence


def test_noise_is_close_to_no_variant(scene_file: SceneWriter) -> None:
    case = case_of(scene_file(top=GRAVITY))
    good = verlet_of(case)
    noise = np.random.default_rng(1).uniform(-0.1, 0.1, good.force_N.shape) * good.force_N.max()
    said = diagnose(case, "yade", replace(good, force_N=good.force_N + noise))
    assert said is not None
    assert (said.kind, said.matched) == ("", False)
    assert said.sentence.startswith("no variant explains the deviation of ")
    assert said.sentence.endswith(" of the largest change; none is close")
    assert said.left > 0.5 * said.deviation


def test_a_deviation_close_to_the_horizon_has_no_diagnosis() -> None:
    case = case_of("fig4", "run.duration=20 ms", "run.time_step=0.5 us")
    rounded = verlet_in_heights(case)
    _, samples = comparable(baseline_of(case).rounding_N / rounded.force_N.max())
    first = samples - WINDOW // 2
    force = rounded.force_N.copy()
    force[first:] += 0.01 * force.max()
    said = diagnose(case, "yade", replace(rounded, force_N=force))
    assert said is not None
    when = f"{case.sample_times_s[first] * 1e6:g} µs"
    assert said.sentence.startswith(f"no diagnosis: the run deviates from its scene at {when}, ")
    assert "too close to the horizon" in said.sentence


@pytest.mark.parametrize(("left", "matches"), [(9e-10, True), (1.1e-9, False)])
def test_a_match_explains_nearly_all_of_a_deviation(left: float, matches: bool) -> None:
    assert Found("", "", left, allowed=1e-8, deviation=1e-7).matches is matches
