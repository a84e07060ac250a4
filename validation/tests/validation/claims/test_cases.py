"""Cases beyond the paper: their file, their verdicts, and errors that turn red."""

import math
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.chain.trace import Trace
from drivers.engines import codes
from postproc.paper.simulate import exact
from validation.chapters import Options, read_section, read_table, rows_in, write_table
from validation.checks import FAIL, NOT_RUN, PASS, RUN, Check, without_run
from validation.claims.cases import MEASURES, Posed, pose, read_independent, unit_of
from validation.claims.claims_chapter import measure
from validation.claims.judged import IN_REPO, judge_cases
from validation.tests.helpers.commands import assert_in_order, beads
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import EnginesWriter, StandIn
from validation.tests.validation.claims.published import published_checks

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
CHEAP = ("two-glass-spheres", "aluminium-on-plane")


def load(path: Path) -> list[Posed]:
    return [one for entry in read_independent(path) for one in pose(entry, path)]


def shipped(*names: str) -> str:
    """The text of some shipped cases."""
    parts = [f"[[case]]{part}" for part in paths.INDEPENDENT.read_text().split("[[case]]")[1:]]
    return "\n".join(part for part in parts if any(f'id = "{name}"' in part for name in names))


BAD = [
    ("", "case: missing key", ""),
    ("case = []", "case: found []", "1 item"),
    (CASE.replace("source =", "sours = 1\nsource ="), "case.0.sours: unknown key", "did you mean source?"),
    (CASE.replace('"impact"', '"impakt"'), 'case glass: measure: found "impakt"', "impact, "),
    (CASE.replace("peak_force_N", "peak_force_kN"), 'check.quantity: found "peak_force_kN"', "peak_force_N"),
    (CASE.replace("two-spheres", "three-spheres"), "three-spheres: scene not found", "two-spheres"),
    (CASE.replace("two-spheres", "../../etc/passwd"), "passwd", "ending in .toml"),
    (CASE.replace('scene = "two-spheres"', ""), "case glass: missing key scene or study", ""),
    (CASE.replace("scene =", 'study = "restitution"\nscene ='), "case glass: keys scene and study", "give one of them"),
    (CASE.replace('scene = "two-spheres"', 'study = "nosuch"'), "nosuch: study not found", "restitution"),
    (CASE.replace("absolute = 0.5", ""), "peak_force_N: missing key within or absolute", ""),
    (CASE.replace("absolute = 0.5", "absolute = 1.0\nwithin = 0.1"), "keys within and absolute", "give one of them"),
    (CASE.replace("absolute = 0.5", "absolute = nan"), "absolute: found nan", "a finite number"),
    (CASE.replace("absolute = 0.5", "absolute = -0.5"), "absolute: found -0.5", "above 0"),
    (CASE.replace("absolute = 0.5", 'absolute = "0.5"'), 'absolute: found "0.5"', "a plain number"),
    (CASE.replace("10697.0", "inf"), "expected: found inf", "a finite number"),
    (CASE.replace("10697.0\nabsolute", "0.0\nwithin"), "within with expected = 0", "absolute"),
    (CASE.replace('"half of the last digit"', '""'), 'reason: found ""', "at least 1"),
    (CASE.replace('id = "glass"', 'id = "../x"'), 'id: found "../x"', "letters, digits"),
    (CASE + CASE, "case glass: id used twice", ""),
    (CASE + CHECK.format("duration_s") * 2, "check duration_s: found check given twice", "once"),
    (CASE.replace('measure = "impact"', 'measure = "train"').replace("peak_force_N", "wave_2_over_first"),
     "case glass: found no contact 30 below a striker's", 'the measure "train"'),
    (CASE.replace("scene =", 'set = ["gravity=9.81 m/s^2"]\nscene ='),
     "case glass: found a case with loads", "impact"),
    (CASE.replace("scene =", 'set = ["contact.restitution=0.5"]\nscene =') + CHECK.format("duration_s"),
     "check duration_s: missing key expected", "no theory gives"),
    (CASE.replace("scene =", 'set = ["chain.count=0"]\nscene ='), "chain", ""),
    (CASE.replace("scene =", 'set = ["chain.count"]\nscene ='), "not of the form KEY=VALUE", "chain.count=60"),
    ("[[case]\n", "independent.toml: not valid TOML", "at line 1"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "found", "allowed"), BAD, ids=range(len(BAD)))
def test_a_wrong_file_is_named_in_one_line(tmp_path: Path, text: str, found: str, allowed: str) -> None:
    path = tmp_path / "independent.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load(path)
    assert_in_order(str(caught.value), found, allowed)


def test_a_wrong_file_ends_the_command_with_code_two(tmp_path: Path) -> None:
    (tmp_path / "cases.toml").write_text(CASE.replace("10697.0", '"a lot"'))
    where = [f"--{name}" for name in ("results", "runs")]
    done = beads("claims", "--file", tmp_path / "cases.toml", where[0], tmp_path / "r", where[1], tmp_path / "q")
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert "case.0.check.0.expected" in done.stderr
    assert [each.name for each in tmp_path.iterdir()] == ["cases.toml"]


def test_an_own_case_with_the_id_of_a_statement_is_refused_before_a_run(tmp_path: Path) -> None:
    (tmp_path / "cases.toml").write_text(CASE.replace('"glass"', '"supersonic"'))
    with pytest.raises(InputError, match="case supersonic: found the id of a statement"):
        measure(Options(file=tmp_path / "cases.toml", runs=tmp_path / "runs"))
    assert not (tmp_path / "runs").exists()


def test_the_shipped_cases_use_every_measure_and_quote_measurements() -> None:
    entries = read_independent()
    assert {entry.measure for entry in entries} == set(MEASURES)
    for entry in entries:
        for check in entry.check:
            assert any(letter.isdigit() for letter in check.reason), f"{entry.id}: {check.reason}"


def test_units_stand_at_the_end_of_names() -> None:
    names = ("peak_force_N", "duration_s", "peak_overlap_m", "sound_speed_m_s", "cutoff_Hz", "restitution")
    assert [unit_of(name) for name in names] == ["N", "s", "m", "m/s", "Hz", ""]


@pytest.fixture
def cheap(tmp_path: Path) -> Path:
    path = tmp_path / "cheap.toml"
    path.write_text(shipped(*CHEAP))
    return path


@pytest.mark.long
def test_the_command_on_two_cases(cheap: Path, shared_runs: Path, tmp_path: Path) -> None:
    for code in codes():
        need(code)
    where = ("--file", cheap, "--results", tmp_path / "results", "--runs", shared_runs)
    done = beads("claims", *where)
    assert done.returncode == 0, done.stderr
    lines = rows_in(read_table(tmp_path / "results" / "claims.csv", Check, "claims"), Check)
    assert {line.verdict for line in lines} == {PASS}
    per_engine = Counter(line.engine for line in lines)
    assert set(per_engine) >= {"reference", "verlet", *codes()}
    assert set(per_engine.values()) == {14}  # seven numbers a case
    assert f"cases beyond the paper: {len(lines)} passed, 0 failed, 0 not run" in done.stdout

    before = sorted(shared_runs.rglob("run.json"))
    changed = {path: path.stat().st_mtime_ns for path in before}
    cheap.write_text(cheap.read_text().replace("expected = 10697.0", "expected = 10698.0"))  # printed: 10.697 kN
    done = beads("claims", *where)
    assert done.returncode == 1
    red = [
        line
        for line in rows_in(read_table(tmp_path / "results" / "claims.csv", Check, "claims"), Check)
        if line.verdict == FAIL
    ]
    assert {(line.scene, line.quantity) for line in red} == {("two-glass-spheres", "peak_force_N against quoted")}
    assert {line.engine for line in red} == set(per_engine)
    assert len(done.stderr.strip().splitlines()) == 1 + len(red)  # with the heading
    assert "found 10696.889 N, expected 10698 N" in done.stderr
    assert {path: path.stat().st_mtime_ns for path in sorted(shared_runs.rglob("run.json"))} == changed, "ran again"


def test_a_soft_wall_in_one_engine_is_red_there_alone(
    cheap: Path, shared_runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A wall contact sqrt(1/2) times as stiff, as by a wrong radius."""

    def soft(case: Case) -> Trace:
        chain = case.chain
        stiffness = chain.stiffness.copy()
        stiffness[0] /= math.sqrt(2)
        return exact(replace(case, chain=replace(chain, stiffness=stiffness))).trace

    monkeypatch.setitem(IN_REPO, "verlet", soft)
    cheap.write_text(shipped("aluminium-on-plane"))
    lines = judge_cases(cheap, shared_runs)
    red = {line.quantity.partition(" ")[0] for line in lines if line.verdict == FAIL}
    assert {line.engine for line in lines if line.verdict == FAIL} == {"verlet"}
    assert red == {"peak_force_N", "peak_overlap_m", "duration_s"}  # a softer wall gives all of the speed back


def test_forces_of_one_in_a_hundred_million_more_are_red(
    cheap: Path, shared_runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stronger(case: Case) -> Trace:
        trace = exact(case).trace
        return replace(trace, force_N=trace.force_N * (1 + 1e-8))

    monkeypatch.setitem(IN_REPO, "reference", stronger)
    lines = judge_cases(cheap, shared_runs)
    red = [line for line in lines if line.verdict == FAIL]
    assert {(line.engine, line.quantity) for line in red} == {("reference", "peak_force_N against theory")}


def test_an_engine_that_breaks_fails_with_its_words(tmp_path: Path, cheap: Path, stand_in: StandIn) -> None:
    stand_in("yade", "echo the wheel came off >&2; exit 3\n")
    cheap.write_text(shipped("aluminium-on-plane"))
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


def test_a_case_without_state_does_not_take_it_from_another(tmp_path: Path) -> None:
    """Their decks are equal, and so is their run."""
    for code in codes():
        need(code)
    both = CASE + CASE.replace('"glass"', '"bare"').replace("scene =", "set = ['run.record=[\"forces\"]']\nscene =")
    path = tmp_path / "both.toml"
    path.write_text(both)
    found = {(line.scene, line.engine): line for line in judge_cases(path, tmp_path / "runs")}
    for code in codes():
        assert found["glass", code].verdict == PASS
        assert (found["bare", code].verdict, found["bare", code].where[:18]) == (FAIL, "no state recorded;")


# ---- table and section


def write(checks: list[Check], folder: Path) -> None:
    write_table(folder / "claims.csv", Check, checks)


def test_the_table_comes_back_as_it_was_written(tmp_path: Path) -> None:
    checks = published_checks()
    checks[-1] = replace(checks[-1], where='a "word", and\nanother', found=0.1 + 0.2)
    write(checks, tmp_path)
    assert rows_in(read_table(tmp_path / "claims.csv", Check, "claims"), Check) == checks
    assert read_section("claims", tmp_path)["checks"][-1] == checks[-1]
    assert read_section("claims", tmp_path / "nowhere") == {}


@pytest.mark.parametrize("change", [{"value": 5.0}, {"value": math.nan}, {"verdict": FAIL}])
def test_a_verdict_that_disagrees_with_its_numbers_is_reported(change: dict[str, Any], tmp_path: Path) -> None:
    lines = published_checks()
    write([*lines[:-1], replace(lines[-1], **change)], tmp_path)
    with pytest.raises(InputError, match=r"verdict: found (pass|fail) of"):
        read_section("claims", tmp_path)


def test_a_table_without_a_case_is_reported(tmp_path: Path) -> None:
    last = published_checks()[-1].scene
    write([check for check in published_checks() if check.scene != last], tmp_path)
    with pytest.raises(InputError, match="other claims or cases"):
        read_section("claims", tmp_path)


def test_a_row_has_the_value_furthest_from_the_published_one_and_a_failed_run_its_words(tmp_path: Path) -> None:
    checks = published_checks()
    first = next(check for check in checks if check.scene == "two-glass-spheres")
    worst = replace(first, engine="yade", value=0.9 * first.limit, found=1.25)
    checks = [worst if (check.scene, check.engine, check.quantity) == (first.scene, "yade", first.quantity) else check
              for check in checks if (check.scene, check.engine) != ("two-limestone-spheres", "yade")]  # fmt: skip
    checks.append(without_run("two-limestone-spheres", "yade", "it blew up", FAIL))
    write(sorted(checks, key=lambda check: check.scene == "x"), tmp_path)
    cases = {entry.id: (verdict, rows) for entry, verdict, rows in read_section("claims", tmp_path)["cases"]}
    verdict, rows = cases["two-glass-spheres"]
    assert (verdict, rows[0].found, rows[0].how) == (PASS, "1.25", "by yade")
    assert rows[0].words == MEASURES["impact"].quantities["peak_force_N"]
    verdict, rows = cases["two-limestone-spheres"]
    assert (verdict, rows[-1].verdict, rows[-1].why) == (FAIL, FAIL, "it blew up")


@pytest.mark.long
def test_all_cases_pass_on_all_engines(shared_runs: Path) -> None:
    for code in codes():
        need(code)
    assert [line for line in judge_cases(runs=shared_runs) if line.verdict != PASS] == []
