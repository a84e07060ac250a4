"""Cases beyond the paper: their file, their verdicts, and errors that turn red."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.case import Case, build_case
from drivers.chain.trace import Trace
from drivers.scene.read_scene import read_scene
from postproc.read.motion import exact
from validation.chapters import claims
from validation.chapters.claims import IN_REPO, function_of, judge, posed, read_claims
from validation.checks import FAIL, NOT_RUN, PASS, RUN, Check
from validation.claims import linear_waves
from validation.report.parts import read_part
from validation.tests.helpers.commands import assert_in_order, beads
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import EnginesWriter, StandIn

CASE = """
[[case]]
id = "glass"
title = "Two spheres"
source = "somebody"
scene = "two-spheres"
measure = "impact"
[[case.check]]
quantity = "peak_force_N"
expected = 10697.0
absolute = 0.5
reason = "half of the last digit"
"""
CHECK = '[[case.check]]\nquantity = "{}"\nwithin = 1e-6\nreason = "because"\n'


CASES = {claim.id: claim for claim in read_claims(paths.INDEPENDENT)}


def load(path: Path) -> None:
    for claim in read_claims(path):
        posed(claim)


def judge_cases(path: Path, runs: Path) -> list[Check]:
    return judge(read_claims(path), runs)


def shipped(name: str) -> str:
    """The text of a shipped case."""
    (part,) = (part for part in paths.INDEPENDENT.read_text().split("[[case]]")[1:] if f'id = "{name}"' in part)
    return f"[[case]]{part}"


BAD = [
    (CASE.replace("source =", "sours = 1\nsource ="), "case glass: sours: unknown key", "did you mean source?"),
    (CASE.replace('"impact"', '"impakt"'), 'case glass: measure: found "impakt"', "impact, "),
    (CASE.replace("peak_force_N", "peak_force_kN"), 'check.quantity: found "peak_force_kN"', "peak_force_N"),
    (CASE.replace('scene = "two-spheres"', ""), "case glass: missing key scene or study", ""),
    (CASE.replace("scene =", 'study = "restitution"\nscene ='), "case glass: keys scene and study", "give one of them"),
    (CASE.replace("absolute = 0.5", ""), "peak_force_N: missing key within or absolute", ""),
    (CASE.replace("absolute = 0.5", "absolute = 1.0\nwithin = 0.1"), "keys within and absolute", "give one of them"),
    (CASE.replace("absolute = 0.5", "absolute = -0.5"), "absolute: found -0.5", "greater than 0"),
    (CASE.replace("10697.0\nabsolute", "0.0\nwithin"), "within with expected = 0", "absolute"),
    (CASE.replace('id = "glass"', 'id = "../x"'), 'id: found "../x"', "letters, digits"),
    (CASE + CASE, "case glass: id used twice", ""),
    (CASE + CHECK.format("duration_s") * 2, "check duration_s: found check given twice", "once"),
    (CASE.replace('measure = "impact"', 'measure = "train"').replace("peak_force_N", "wave_2_over_first"),
     "case glass: found no contact 30 below a striker's", 'the measure "train"'),
    (CASE.replace("scene =", 'set = ["gravity=9.81 m/s^2"]\nscene ='),
     "case glass: found a case with loads", "impact"),
    (CASE.replace("scene =", 'set = ["contact.restitution=0.5"]\nscene =') + CHECK.format("duration_s"),
     "check duration_s: missing key expected", "no theory gives"),
    ("[[case]\n", "independent.toml: not valid TOML", "at line 1"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "found", "allowed"), BAD, ids=range(len(BAD)))
def test_a_wrong_file_is_named_in_one_line(tmp_path: Path, text: str, found: str, allowed: str) -> None:
    path = tmp_path / "independent.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load(path)
    assert_in_order(str(caught.value), found, allowed)


def test_a_case_with_the_id_of_a_statement_ends_the_command_before_a_run(tmp_path: Path) -> None:
    (tmp_path / "cases.toml").write_text(CASE.replace('"glass"', '"supersonic"'))
    done = beads("claims", "--file", tmp_path / "cases.toml", "--results", tmp_path / "r", "--runs", tmp_path / "q")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "case supersonic: found the id of a statement" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["cases.toml"]


@pytest.fixture
def cheap(tmp_path: Path) -> Path:
    path = tmp_path / "cheap.toml"
    path.write_text(shipped("aluminium-on-plane"))
    return path


@pytest.fixture
def in_repo(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves the engines of the repository alone."""
    monkeypatch.setattr(claims, "expected_engines", lambda: [*IN_REPO])


@pytest.mark.usefixtures("in_repo")
def test_the_command_passes_a_right_case_and_fails_a_wrong_one(cheap: Path, tmp_path: Path) -> None:
    words = ("claims", "--file", cheap, "--results", tmp_path / "results", "--runs", tmp_path / "runs")
    done = beads(*words)
    assert done.returncode == 0, done.stderr
    assert "cases beyond the paper: 14 passed, 0 failed, 0 not run" in done.stdout  # seven numbers by two engines
    cheap.write_text(cheap.read_text().replace("expected = 11370.0", "expected = 11371.0"))
    done = beads(*words)
    assert done.returncode == 1
    part = read_part("claims", tmp_path / "results")
    assert part
    red = [(check.engine, check.quantity) for check in part.failed]
    assert red == [("reference", "peak_force_N against quoted"), ("verlet", "peak_force_N against quoted")]
    assert done.stderr.count("N, expected 11371 N") == len(red)


def stronger(case: Case) -> Trace:
    """Motion with forces of one in a hundred million more."""
    trace = exact(case).trace
    return replace(trace, force_N=trace.force_N * (1 + 1e-8))


@pytest.mark.usefixtures("in_repo")
def test_a_wrong_engine_is_red_alone(cheap: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(IN_REPO, "verlet", stronger)
    red = [check for check in judge_cases(cheap, tmp_path) if check.verdict == FAIL]
    assert {(check.engine, check.quantity.partition(" ")[0]) for check in red} == {("verlet", "peak_force_N")}


def test_an_engine_that_breaks_fails_with_its_words(tmp_path: Path, cheap: Path, stand_in: StandIn) -> None:
    stand_in("yade", "echo the wheel came off >&2; exit 3\n")
    lines = [line for line in judge_cases(cheap, tmp_path / "runs") if line.engine == "yade"]
    assert [(line.quantity, line.verdict) for line in lines] == [(RUN, FAIL)]
    assert "the wheel came off" in lines[0].where


def test_an_engine_that_is_not_there_or_refuses_is_not_run(
    tmp_path: Path, cheap: Path, engines_file: EnginesWriter
) -> None:
    need("liggghts")
    engines_file('[yade]\ncommand = "no-such-program"')
    text = shipped("aluminium-on-plane").replace("measure =", 'set = ["contact.restitution=0.1"]\nmeasure =')
    cheap.write_text(text[: text.index("check = [")] + CHECK.format("restitution").replace("1e-6", "1e-3"))
    lines = {line.engine: line for line in judge_cases(cheap, tmp_path / "runs")}
    assert lines["yade"].verdict == lines["liggghts"].verdict == NOT_RUN
    assert lines["yade"].where == "not installed"
    assert "contact.restitution" in lines["liggghts"].where
    assert lines["reference"].verdict == PASS


def test_a_case_without_state_does_not_take_it_from_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their decks are equal, and so is their run."""
    need("liggghts")
    monkeypatch.setattr(claims, "expected_engines", lambda: ["liggghts"])
    path = tmp_path / "both.toml"
    path.write_text(
        CASE + CASE.replace('"glass"', '"bare"').replace("scene =", "set = ['run.record=[\"forces\"]']\nscene =")
    )
    glass, bare = judge_cases(path, tmp_path / "runs")
    assert (glass.scene, glass.verdict) == ("glass", PASS)
    assert (bare.scene, bare.verdict, bare.where[:18]) == ("bare", FAIL, "no state recorded;")


@pytest.mark.long
@pytest.mark.usefixtures("in_repo")
def test_the_engines_of_the_repository_pass_all_cases(tmp_path: Path) -> None:
    """Theories are those of two integrators; the report asks the codes."""
    assert [check for check in judge_cases(paths.INDEPENDENT, tmp_path) if check.verdict != PASS] == []


def test_made_up_records_have_their_known_rates_and_peaks() -> None:
    """A fit finds a rate from any start, and a polynomial a peak in noise."""
    time, rate = np.arange(0.0, 100.0, 0.05), 1.0173
    fitted, _, misfit = linear_waves.fit(time, 3.0 * linear_waves.response(2, rate * time), 2, linear_waves.LAST_TAU)
    assert fitted == pytest.approx(rate, rel=1e-12)
    assert misfit < 1e-12
    time = np.arange(0.0, 15.0, 0.1)
    noise = 1e-4 * np.random.default_rng(1).normal(size=time.size)
    signal = np.exp(-((time - 4.03) ** 2) / 2) + 2 * np.exp(-((time - 12.0) ** 2) / 2)
    for disturbed, error in ((signal, 2e-5), (signal + noise, 2e-4)):
        peak = linear_waves.leading_peak(time, disturbed)
        assert (peak.time_s, peak.value) == pytest.approx((4.03, 1.0), abs=error)


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("two-glass-spheres", ["run.duration=20 us"], "do not meet and separate"),
        ("train-2", ["run.duration=0.5 ms"], "waves at contact 21 within run.duration"),
        ("steel-chain", ["run.duration=0.1 ms"], "within run.duration"),
        ("linear-limit-1mN", ["run.duration=1 ms"], "too short"),
        (
            "linear-limit-1mN",
            ["chain.count=20", "chain.bead=[{ from_wall = 20, velocity = '-1 um/s' }]"],
            "the reflection arrives",
        ),
        ("head-on-at-contact", ["run.duration=2.5 ms"], "1 waves within the run"),
        ("cutoff-in-spectrum", ["run.duration=50 us"], "fewer than two lines"),
        ("precompressed-ptfe", ["chain.sensors=[{ from_wall = 40 }]"], "fewer than two sensors"),
        (
            "weak-strike-under-gravity",
            ["run.sample_interval=80 us", "run.time_step=2 us"],
            "sample_interval is too long",
        ),
        ("precompressed-ptfe", ["chain.bead=[{ from_wall = 9, mass = '1 g' }]"], "of unequal beads"),
        ("heavy-impurity", ["chain.bead=[{ from_wall = 70, velocity = '-1 um/s' }]"], "not one bead of another mass"),
        ("transfer-in-band", ["run.duration=4 ms"], "too short to separate"),
        ("transfer-in-band", ["drive.cycles=9"], "no sine force that lasts"),
        ("dimer-bands", ["chain.precompression="], "a contact without static load"),
        ("two-glass-spheres", ["gravity=9.81 m/s^2"], "loads"),
    ],
)
def test_a_run_or_chain_without_the_wave_of_a_case_is_named(name: str, settings: list[str], words: str) -> None:
    entry = CASES[name]
    assert entry.scene
    case = build_case(read_scene(entry.scene, (*entry.set, *settings)))
    with pytest.raises(ValueError, match=words):
        _ = function_of(entry, "_theory")(case), function_of(entry)(case, exact(case).trace)
