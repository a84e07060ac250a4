"""Comparison of a scene: deviations, verdicts, the sentence that sums them up."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.base import paths
from drivers.base.tolerances import tolerance
from drivers.run.finished import EndedRun
from validation.accuracy.baseline import HORIZON, baseline_of
from validation.compare.answer import answer
from validation.compare.comparison import ComparedScene, compare_case
from validation.compare.departure import deviation
from validation.compare.verdict import FAIL, NOT_RUN, PASS, short
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import case_of


def test_a_deviation_says_when_and_where(compared: ComparedScene) -> None:
    trace = compared.runs["verlet"].trace
    force = trace.force_N.copy()
    force[37, 2] += 1e-3
    found = deviation(replace(trace, force_N=force), trace)
    assert found.share == pytest.approx(1e-3 / trace.force_N.max())
    assert (found.time_s, found.quantity) == (trace.time_s[37], "contact 3")
    with pytest.raises(ValueError, match="samples"):
        deviation(replace(trace, force_N=force[:5]), trace)


def test_missing_engines_are_not_run_and_failed_engines_fail(compared: ComparedScene) -> None:
    by_engine = {name: {v.verdict for v in compared.verdicts if v.engine == name} for name in ("liggghts", "yade")}
    assert by_engine == {"liggghts": {NOT_RUN}, "yade": {FAIL}}
    assert {v.verdict for v in compared.verdicts if v.engine in compared.runs} == {PASS}


def test_wrong_forces_fail(compared: ComparedScene) -> None:
    run = compared.runs["verlet"]
    stamped_late = replace(run.trace, force_N=np.roll(run.trace.force_N, 1, axis=0))
    late = replace(run)
    object.__setattr__(late, "trace", stamped_late)
    verdicts = compare_case(compared.case, compared.runs | {"yade": late}, {})
    red = {v.quantity for v in verdicts if v.engine == "yade" and v.verdict == FAIL}
    assert {"force against verlet", "force against reference"} <= red


def test_a_chaotic_chain_is_judged_up_to_its_horizon(shared_runs: Path) -> None:
    case = case_of("fig4", "run.duration=20 ms", "run.sample_interval=10 us", "run.time_step=0.5 us")
    run = finished(case, "verlet", shared_runs)
    baseline = baseline_of(case)
    limit, samples = baseline.allowed, baseline.samples
    assert limit.limit <= 10 * HORIZON
    assert 8e-3 < run.trace.time_s[samples] < 19e-3


def test_every_tolerance_has_a_reason() -> None:
    for kind, quantities in tomllib.loads(paths.TOLERANCES.read_text()).items():
        for quantity in quantities:
            assert len(tolerance(kind, quantity).reason) > 10


def test_the_first_sentence_answers_the_question(compared: ComparedScene) -> None:
    def sentences(runs: dict[str, EndedRun], absent: dict[str, str]) -> list[str]:
        scene = ComparedScene(compared.case, runs, absent, compare_case(compared.case, runs, absent))
        return answer([scene])

    code = compared.runs | {"yade": compared.runs["verlet"]}
    exact = max(v.value for v in compared.verdicts if v.quantity == "force against reference")
    end = f"with the exact motion to {short(exact)} at this time step"
    (first,) = sentences(code, {})
    assert first.startswith(f"Yes: the forces of YADE agree with the same scheme to 0.0 and {end}, for ")
    assert first.endswith(" s of computing per run.")
    first, last = sentences(code, {"liggghts": "not installed"})
    assert first.startswith("Yes: the forces of YADE agree")
    assert last == "LIGGGHTS did not run on scene."
    first, second = sentences(code, {"liggghts": "failed: exit code 1"})
    assert first == "No: LIGGGHTS fails on scene."
    assert second.startswith("Otherwise, the forces of YADE agree with the same scheme to 0.0")
    first, second, _ = sentences(compared.runs, {"yade": "not installed"})
    assert first == "Not known: no code ran."
    assert second.startswith(f"In this repository, the forces of verlet agree {end}")
    assert answer([]) == ["Not known: no code ran."]
