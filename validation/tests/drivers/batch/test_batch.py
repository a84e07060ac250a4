"""Tests of batches: finished rows are kept and never run again, also after failures."""

import os
import shlex
import shutil
import subprocess
from collections import Counter
from pathlib import Path

import pandas as pd
import pytest

from drivers.base import paths
from drivers.batch.store import Store
from drivers.engines import installed
from postproc.paper.simulate import exact
from postproc.read.observables import observe
from validation.tests.helpers.commands import BEADS, beads, beads_process
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import SPEEDS, SceneWriter, StandIn, StudyWriter, case_of

ENGINES = ("reference", "verlet", "liggghts", "yade")


def batch(study: Path, runs: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    return beads("batch", study, "--runs", runs, "--results", results_of(runs), *words)


def results_of(runs: Path) -> Path:
    return runs.parent / f"{runs.name}-results"


def table(runs: Path) -> pd.DataFrame:
    return pd.read_parquet(results_of(runs) / "study.parquet")


def table_bytes(runs: Path) -> list[bytes]:
    return [(results_of(runs) / f"study.{ending}").read_bytes() for ending in ("parquet", "csv")]


def stored(runs: Path) -> Counter[str]:
    """Number of times that each row is in the store."""
    store = Store(runs)
    return Counter(row.identity for row in store.refresh())


def test_the_table(study_file: StudyWriter, scene_file: SceneWriter, tmp_path: Path) -> None:
    path = study_file(SPEEDS.format(3) + '[[axis]]\nkey = "chain.count"\nvalues = [3, 5]', "verlet", "reference")
    done = batch(path, tmp_path / "runs")
    assert (done.returncode, done.stderr) == (0, "")
    found = table(tmp_path / "runs")
    assert list(found.columns[:7]) == [
        "case", "striker.speed_m_s", "chain.count", "engine", "status", "reason", "force_error_share",
    ]  # fmt: skip
    assert list(found["case"]) == [n for n in range(1, 7) for _ in range(2)]
    assert list(found["engine"]) == ["verlet", "reference"] * 6
    assert set(found["status"]) == {"done"}
    case = case_of(scene_file(), "striker.speed=1.25 m/s", "chain.count=5")
    expected = observe(case.layout, exact(case).trace)
    row = found[(found["case"] == 4) & (found["engine"] == "reference")].iloc[0]
    assert (row["striker.speed_m_s"], row["chain.count"]) == (1.25, 5)
    assert row["wall_peak_N"] == pytest.approx(expected["wall_peak_N"], rel=1e-9)
    errors = found.groupby("engine")["force_error_share"]
    assert errors.count()["reference"] == 0
    assert (errors.get_group("verlet") < 1e-4).all()
    costs = pd.read_parquet(results_of(tmp_path / "runs") / "study-cost.parquet")
    assert list(costs.columns)[3:] == ["start_s", "engine_s", "loop_s", "workflow_s", "reference_s"]
    assert (costs["engine_s"] > 0).all()


def test_rows_belong_to_their_cases(study_file: StudyWriter, tmp_path: Path) -> None:
    """Workers take the identities of rows from the cache of the process that planned, here one of its own."""
    path, runs = study_file(SPEEDS.format(4), "verlet"), tmp_path / "runs"
    done = beads_process("batch", path, "--runs", runs, "--results", results_of(runs))
    assert done.returncode == 0, done.stderr
    found = table(runs)
    assert found["wall_peak_N"].is_monotonic_increasing
    assert len(set(found["wall_peak_N"])) == 4


@pytest.mark.long
def test_an_unfinished_table_replaces_none_with_more_rows(study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs = study_file(SPEEDS.format(3), "verlet", top='figure = ["wall_peak_N"]'), tmp_path / "runs"
    other = ("--only", "*=0.5*")
    part = batch(path, runs, *other)
    assert part.stdout.splitlines()[-2:] == ["verlet  1 done", "1 of 3 rows done"]
    done = batch(path, runs)
    assert done.stdout.splitlines()[-1] == "3 of 3 rows done"
    draw = next(line for line in done.stdout.splitlines() if line.startswith("to draw the table: "))
    drawn = beads(*shlex.split(draw.partition(": beads ")[2]))
    assert drawn.returncode == 0, drawn.stderr
    complete = table_bytes(runs)
    words = ("batch", path, "--runs", tmp_path / "others", *other)
    kept = beads(*words, "--results", results_of(runs))
    assert (kept.returncode, kept.stdout) == (1, "verlet  1 done\n1 of 3 rows done\n")
    assert kept.stderr == (
        f"table {results_of(runs) / 'study.csv'} kept: it has 3 rows done, this batch 1 of 3; "
        "--results DIR writes another table\n"
    )
    assert table_bytes(runs) == complete
    assert beads(*words, "--results", tmp_path / "another").returncode == 0
    path.write_text(path.read_text().replace("count = 3", "count = 2"))
    assert batch(path, runs).returncode == 0  # complete, although with fewer rows
    assert list(table(runs)["status"]) == ["done"] * 2


def test_what_is_done_is_not_run_again(study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs = study_file(SPEEDS.format(4), "verlet"), tmp_path / "runs"
    plan = batch(path, runs, "--dry-run")
    assert "verlet  0 done, 4 to do, cost not measured yet" in plan.stdout
    assert not stored(runs)
    assert batch(path, runs, "--only", "striker.speed=0.5*").returncode == 0
    assert list(table(runs)["status"]) == ["done", "to do", "to do", "to do"]
    assert "1 done, 3 to do, about " in batch(path, runs, "--dry-run").stdout
    assert batch(path, runs).returncode == 0
    before = sorted((runs / "batch").glob("*.jsonl"))
    first = table_bytes(runs)
    assert batch(path, runs).returncode == 0
    assert sorted((runs / "batch").glob("*.jsonl")) == before
    assert table_bytes(runs) == first
    assert set(stored(runs).values()) == {1}
    copy = path.with_name("renamed.toml")  # the same cases under another name, and more of them
    copy.write_text(path.read_text() + '[[axis]]\nkey = "wall.material"\nvalues = ["brass", "steel"]')
    assert "verlet  4 done, 4 to do" in batch(copy, runs, "--dry-run").stdout


@pytest.mark.long
def test_cases_of_one_process_are_bit_identical_to_single_runs(scene_file: SceneWriter, tmp_path: Path) -> None:
    scene_file()
    for name in ENGINES:
        need(name)
    path, runs = tmp_path / "study.toml", tmp_path / "runs"
    kinds = [
        'values = ["", { material = "brass" }]',
        'values = [{ shape = "flat", material = "alumina", mass = "0.47 g", speed = "0.4 m/s" },'
        ' { material = "ptfe", diameter = "4.76 mm", speed = "1 m/s" }]',
        'values = ["0 m/s^2", "9.81 m/s^2"]',
    ]
    axes = "".join(
        f'[[axis]]\nkey = "{key}"\n{values}\n'
        for key, values in zip(("wall", "striker", "gravity"), kinds, strict=True)
    )
    path.write_text(
        f'scene = "scene.toml"\nengines = {list(ENGINES)}\nset = {{ "chain.mass_scatter" = "1 mg" }}\n{axes}'
    )
    done = batch(path, runs, "--workers", "1")
    assert done.returncode == 0, done.stderr
    for number in (4, 7, 8):
        shown = beads("show", path, str(number), "--runs", runs)
        assert shown.returncode == 0, shown.stdout + shown.stderr
        assert shown.stdout.count("as in the batch, bit for bit") == 4, shown.stdout
    folder = Path(next(line for line in shown.stdout.splitlines() if "yade" in line).split("  ")[0])
    assert {"chain.py", "forces.parquet", "sensors.csv", "run.json"} <= {file.name for file in folder.iterdir()}


# a script in place of LIGGGHTS that changes the deck of one case
MEDDLER = """#!/bin/sh
case "$*" in *-help*) exec {real} "$@";; esac
fifo=$(mktemp -u); mkfifo $fifo; exec 3<&0
(while IFS= read -r line; do
  if [ "$line" = "include chain.in" ] && grep -q -- " {speed} 0 0 0" case/chain.data; then {command}
  else echo "$line"; fi
done <&3) > $fifo &
exec {real} "$@" < $fifo
"""


@pytest.mark.parametrize(
    ("command", "status", "reason"),
    [
        ("kill -SEGV $$", "failed", "killed by signal 11"),
        *(
            pytest.param(*each, marks=pytest.mark.long)
            for each in (
                ("echo nonsense", "failed", "exit code 1: ERROR: Unknown command: nonsense"),
                ("echo shell sleep 300", "timeout", "killed at the time limit of 3 s"),
                ("echo quit", "failed", "no output"),
            )
        ),
    ],
)
@pytest.mark.long
def test_a_failure_is_charged_to_its_case(
    command: str, status: str, reason: str, study_file: StudyWriter, tmp_path: Path
) -> None:
    need("liggghts")
    path, runs = study_file(SPEEDS.format(4), "liggghts", top='limit = "3 s"'), tmp_path / "runs"
    programs = tmp_path / "bin"
    programs.mkdir()
    meddler = programs / "liggghts"
    meddler.write_text(MEDDLER.format(real=shutil.which("liggghts"), speed=-1, command=command))
    meddler.chmod(0o755)
    where = {"PATH": f"{programs}:{os.environ['PATH']}"}
    words = ("batch", path, "--runs", runs, "--results", results_of(runs), "--workers", "1")
    done = beads_process(*words, **where)
    assert done.returncode == 1
    last = done.stderr.strip().splitlines()
    assert reason in last[-2]
    assert last[-1] == "1 failed; --retry runs them again"
    failed = table(runs)
    assert list(failed["status"]) == ["done", status, "done", "done"]
    assert beads_process(*words, **where).returncode == 1  # a failure stays one, and is not run again
    assert set(stored(runs).values()) == {1}
    meddler.write_text(f'#!/bin/sh\nexec {shutil.which("liggghts")} "$@"\n')
    again = beads_process(*words, "--retry", **where)
    assert again.returncode == 0, again.stderr
    good = [0, 2, 3]
    assert failed.iloc[good].equals(table(runs).iloc[good])
    assert set(table(runs)["status"]) == {"done"}


@pytest.mark.long
def test_an_unstable_case_is_refused_or_fails_alone(study_file: StudyWriter, tmp_path: Path) -> None:
    axes = '[[axis]]\nzip = { "run.time_step" = ["0.1 us", "25 us"], "run.sample_interval" = ["1 us", "25 us"] }'
    refused = batch(study_file(axes, *installed(ENGINES)), tmp_path / "runs")
    assert refused.returncode == 2
    assert "case 2 (" in refused.stderr
    assert "run.time_step: found 2.5e-05 s; allowed: at most" in refused.stderr
    done = batch(study_file(axes, *installed(ENGINES), top="unsafe = true"), tmp_path / "runs")
    assert done.returncode == 1
    assert "unstable at t = " in done.stderr
    found = table(tmp_path / "runs").set_index(["case", "engine"])["status"]
    assert set(found[1]) == {"done"}
    assert set(found[2].drop("reference")) == {"failed"}
    assert found[2, "reference"] == "done"


def test_a_missing_engine_is_a_failure_and_the_others_run(study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs = study_file(SPEEDS.format(2), "verlet", "yade"), tmp_path / "runs"
    done = beads_process("batch", path, "--runs", runs, "--results", results_of(runs), PATH="/usr/none")
    assert (done.returncode, "yade    2 not installed" in done.stdout) == (1, True)
    assert list(table(runs)["status"]) == ["done", "not installed"] * 2


@pytest.mark.long
def test_rows_of_a_changed_deck_build_or_source_are_stale(
    study_file: StudyWriter, scene_file: SceneWriter, stand_in: StandIn, tmp_path: Path
) -> None:
    need("yade")
    checkout = tmp_path / "checkout"  # a copy, to change a template in
    for folder in ("drivers", "inputs", "postproc", "templates", "validation"):
        shutil.copytree(paths.ROOT / folder, checkout / folder, ignore=shutil.ignore_patterns("tests", "__pycache__"))
    path, runs = study_file('[[axis]]\nkey = "chain.count"\nvalues = [3, 4]', "verlet", "yade"), tmp_path / "runs"

    def asked(command: str, *words: str | Path) -> str:
        done = subprocess.run(
            [*BEADS, command, path, "--runs", runs, *words],
            cwd=checkout, capture_output=True, text=True, check=False, env=os.environ | {"PYTHONPATH": str(checkout)},
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout

    asked("batch", "--results", tmp_path / "results")
    assert asked("status") == "verlet  2 done\nyade    2 done\n"
    template = checkout / "templates" / "yade" / "chain.py.j2"
    template.write_text(template.read_text() + "# another line\n")
    assert asked("status") == "verlet  2 done\nyade    2 stale\n"
    asked("batch", "--results", tmp_path / "results")
    assert asked("status") == "verlet  2 done\nyade    2 done\n"
    stand_in("yade", f'exec {shutil.which("yade")} "$@"\n')  # another build
    assert asked("status") == "verlet  2 done\nyade    2 stale\n"
    source = checkout / "postproc" / "read" / "signals.py"
    source.write_text(source.read_text() + "# another line\n")
    assert asked("status") == "verlet  2 stale\nyade    2 stale\n"
    asked("batch", "--results", tmp_path / "results")
    scene_file(chain="bead = [{ from_wall = 4, gap_below = '1 um' }]")  # a scene that only the longer chain can have
    path.write_text(path.read_text().replace("values = [3, 4]", "values = [4, 5]"))
    assert "verlet  1 stale, 1 to do\n" in asked("status")
    scene_file()
    assert "verlet  1 done, 1 to do\n" in asked("status")


@pytest.mark.long
def test_two_simultaneous_batches_share_the_work(study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs = study_file(SPEEDS.format(150), "verlet", "reference"), tmp_path / "runs"
    words = [*BEADS, "batch", str(path), "--runs", str(runs)]
    results = [tmp_path / "one", tmp_path / "two"]
    both = [subprocess.Popen([*words, "--results", str(place)], stdout=subprocess.DEVNULL) for place in results]
    assert [process.wait(120) for process in both] == [0, 0]
    assert results[0].joinpath("study.parquet").read_bytes() == results[1].joinpath("study.parquet").read_bytes()
    assert set(stored(runs).values()) == {1}
    assert len(stored(runs)) == 300


def test_temporary_files_may_lie_deep_and_go_at_the_end(study_file: StudyWriter, tmp_path: Path) -> None:
    """As on clusters, where the path of a socket in TMPDIR exceeds the system's limit."""
    need("lammps")
    deep = tmp_path / ("job" * 40)
    deep.mkdir()
    path, runs = study_file(SPEEDS.format(2), "lammps", "verlet"), tmp_path / "runs"
    done = beads_process("batch", path, "--runs", runs, "--results", results_of(runs), TMPDIR=str(deep))
    assert (done.returncode, done.stderr) == (0, "")
    assert [*deep.iterdir()] == []


@pytest.mark.long
def test_rows_without_a_reference_run_are_tried_again(study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs = study_file(SPEEDS.format(2), "verlet", top='limit = "1 us"'), tmp_path / "runs"
    assert batch(path, runs).returncode == 1
    assert set(table(runs)["status"]) == {"timeout"}
    path.write_text(path.read_text().replace("1 us", "60 s"))
    assert batch(path, runs).returncode == 1
    assert batch(path, runs, "--retry").returncode == 0
    assert table(runs)["force_error_share"].notna().all()


@pytest.mark.long
def test_patterns_without_observables(study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs = study_file(SPEEDS.format(2), "verlet", top='observables = ["wall_peak_*", "wal_*"]'), tmp_path / "runs"
    done = batch(path, runs)
    assert (done.returncode, '"wal_*" matches no observable' in done.stderr) == (1, True)
    assert set(table(runs).columns[-4:]) == {"force_error_share", "wall_peak_N", "wall_peak_2_N", "wall_peak_3_N"}


def test_observables_that_rows_do_not_show_are_counted(study_file: StudyWriter, tmp_path: Path) -> None:
    axes = (
        '[[axis]]\nkey = "run.duration"\nvalues = ["20 us", "0.3 ms"]\n'
        '[[axis]]\nkey = "chain.sensors"\nvalues = [[], [{ from_wall = 3 }]]'
    )
    path, runs = study_file(axes, "verlet", "reference", top='observables = ["*_peak_N"]'), tmp_path / "runs"
    lines = [
        "wall_peak_N: not seen in 4 of 8 rows: the gauge shows no pulse before the end of the run",
        "bead_3_peak_N: not seen in 2 of 8 rows: the gauge shows no pulse before the end of the run",
        "bead_3_peak_N: not in 4 of 8 rows: their scenes have no such gauge",
    ]
    for _ in range(2):  # the second batch runs no case
        done = batch(path, runs)
        assert (done.returncode, done.stderr) == (0, "")
        assert [line for line in done.stdout.splitlines() if ": not " in line] == lines


def test_equal_cases_run_once(study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs = study_file("[[axis]]\nseeds = 6", "verlet"), tmp_path / "runs"  # nothing is drawn at random
    assert batch(path, runs).returncode == 0
    assert list(stored(runs).values()) == [1]
    assert list(table(runs)["status"]) == ["done"] * 6


@pytest.mark.long
def test_damaged_files_do_not_count(study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs = study_file(SPEEDS.format(4), "verlet"), tmp_path / "runs"
    assert batch(path, runs).returncode == 0
    first = table_bytes(runs)
    for file in (runs / "batch").glob("*.jsonl"):
        file.write_text(file.read_text().replace("1", "2", 1))
    status = beads("status", path, "--runs", runs)
    assert "damaged file" in status.stderr
    assert status.stdout == "verlet  4 to do\n"
    assert batch(path, runs).returncode == 0
    assert table_bytes(runs) == first


def test_status_lists_cases(study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs = study_file(SPEEDS.format(2), "verlet"), tmp_path / "runs"
    assert batch(path, runs, "--slice", "2/2").returncode == 0
    status = beads("status", path, "--runs", runs, "--list").stdout
    assert status.splitlines() == [
        "1: striker.speed=0.5 m/s: verlet to do",
        "2: striker.speed=2.0 m/s: verlet done",
        "verlet  1 done, 1 to do",
    ]
