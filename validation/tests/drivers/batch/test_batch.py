"""Tests of batches: finished rows are kept and never run again, also after failures."""

import json
import os
import platform
import shutil
import sqlite3
import subprocess
import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import psutil
import pytest

from drivers.base import paths
from drivers.batch import rows as batch_rows
from drivers.batch import store as batch_store
from drivers.batch.store import Store, StudyRow
from drivers.batch.tables import read_study_table
from drivers.limits import needed_tolerance
from postproc.read.motion import exact
from postproc.read.observables import observe
from validation.tests.helpers.commands import BEADS, beads, beads_process
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import SPEEDS, SceneWriter, StandIn, StudyWriter, case_of


def batch(study: Path, runs: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    return beads("batch", study, "--runs", runs, "--results", results_of(runs), *words)


def batch_here(study: Path, runs: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """A batch whose rows this process runs before, which is quicker than the start of workers."""
    beads("batch", study, "--runs", runs, "--slice", "1/1", *words)
    return batch(study, runs, *words)


def results_of(runs: Path) -> Path:
    return runs.parent / f"{runs.name}-results"


def table(runs: Path) -> pd.DataFrame:
    return pd.read_parquet(results_of(runs) / "study.parquet")


def table_bytes(runs: Path) -> list[bytes]:
    return [(results_of(runs) / f"study.{ending}").read_bytes() for ending in ("parquet", "csv")]


def sql(runs: Path, query: str, *values: Any) -> list[tuple[Any, ...]]:
    """Result of a query of the database, as anybody may ask it."""
    if not (runs / "batch.sqlite").exists():
        return []
    with closing(sqlite3.connect(runs / "batch.sqlite", timeout=20)) as connection, connection:
        return connection.execute(query, values).fetchall()


def stored(runs: Path) -> list[int]:
    """Places of the rows in the order of their writing: a row that is written again leaves a gap."""
    return [place for (place,) in sql(runs, "SELECT rowid FROM rows ORDER BY rowid")]


def test_the_table(study_file: StudyWriter, scene_file: SceneWriter, tmp_path: Path) -> None:
    """On clusters the path of a socket in TMPDIR exceeds the system's limit."""
    axes = f'{SPEEDS.format(3)}[[axis]]\nkey = "chain.count"\nvalues = [3, 5]'
    path, runs, deep = study_file(axes, "verlet", "reference"), tmp_path / "runs", tmp_path / ("job" * 40)
    deep.mkdir()
    done = beads_process("batch", path, "--runs", runs, "--results", results_of(runs), TMPDIR=str(deep))
    assert (done.returncode, done.stderr) == (0, "")
    assert [*deep.iterdir()] == []
    rows = table(runs)
    assert list(rows.columns[:7]) == [
        "case", "striker.speed_m_s", "chain.count", "engine", "status", "reason", "force_error_share",
    ]  # fmt: skip
    assert list(rows["case"]) == [n for n in range(1, 7) for _ in range(2)]
    assert list(rows["engine"]) == ["verlet", "reference"] * 6
    assert set(rows["status"]) == {"done"}
    case = case_of(scene_file(), "striker.speed=1.25 m/s", "chain.count=5")
    expected = observe(case.layout, exact(case).trace)
    row = rows[(rows["case"] == 4) & (rows["engine"] == "reference")].iloc[0]
    assert (row["striker.speed_m_s"], row["chain.count"]) == (1.25, 5)
    assert row["wall_peak_N"] == pytest.approx(expected["wall_peak_N"], rel=needed_tolerance(case))
    errors = rows.groupby("engine")["force_error_share"]
    assert errors.count()["reference"] == 0
    assert (errors.get_group("verlet") < 1e-4).all()
    costs = pd.read_parquet(results_of(runs) / "study-cost.parquet")
    assert list(costs.columns)[3:] == ["start_s", "engine_s", "loop_s", "workflow_s", "reference_s"]
    assert (costs["engine_s"] > 0).all()


def test_rows_done_or_equal_are_not_run_again_unless_damaged(study_file: StudyWriter, tmp_path: Path) -> None:
    """Nothing is drawn at random, so cases that differ by their seed have equal numbers."""
    path, runs = study_file(f"{SPEEDS.format(2)}[[axis]]\nseeds = 2\n", "verlet"), tmp_path / "runs"
    assert "verlet  4 to do\nexpected time: not known yet; " in batch(path, runs, "--dry-run").stdout
    assert not runs.exists()
    assert batch_here(path, runs, "--only", "striker.speed=0.5*").stdout.endswith("verlet  2 done\n")
    assert list(table(runs)["status"]) == ["done", "done", "to do", "to do"]
    assert sql(runs, "SELECT count(DISTINCT identity), count(DISTINCT loop_s) FROM rows") == [(1, 1)]
    assert "2 done, 2 to do\nexpected time: " in batch(path, runs, "--dry-run").stdout
    assert beads("status", path, "--runs", runs, "--list").stdout.splitlines()[1:] == [
        "2: striker.speed=0.5 m/s, seed=2: verlet done",
        "3: striker.speed=2.0 m/s, seed=1: verlet to do",
        "4: striker.speed=2.0 m/s, seed=2: verlet to do",
        "verlet  2 done, 2 to do",
    ]
    assert batch_here(path, runs).returncode == 0
    first = table_bytes(runs)
    assert batch_here(path, runs).returncode == 0
    assert stored(runs) == [1, 2, 3, 4]
    assert table_bytes(runs) == first
    sql(runs, "UPDATE rows SET observables = replace(observables, '1', '2') WHERE rowid < 3")
    sql(runs, "UPDATE rows SET sha256 = NULL, ended = 'never' WHERE rowid = 3")
    again = batch(path, runs)
    assert (again.returncode, again.stderr) == (0, f"3 damaged rows in {runs / 'batch.sqlite'}: run again\n")
    assert table_bytes(runs) == first
    copy = path.with_name("renamed.toml")  # the same cases under another name, and more of them
    copy.write_text(path.read_text() + '[[axis]]\nkey = "wall.material"\nvalues = ["brass", "steel"]')
    assert "verlet  4 done, 4 to do" in batch(copy, runs, "--dry-run").stdout


def test_anybody_reads_the_database(study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs = study_file(SPEEDS.format(2), "verlet"), tmp_path / "runs"
    assert batch_here(path, runs).returncode == 0
    peaks = sql(runs, "SELECT label, observables ->> 'wall_peak_N' FROM rows WHERE study = 'study' ORDER BY label")
    assert [label for label, _ in peaks] == ["striker.speed=0.5 m/s", "striker.speed=2.0 m/s"]
    assert [peak for _, peak in peaks] == table(runs)["wall_peak_N"].to_list()
    with closing(sqlite3.connect(runs / "batch.sqlite")) as connection:
        frame = pd.read_sql("SELECT * FROM rows", connection)
    assert set(frame["status"]) == {"done"}
    unseen = [name for name, value in json.loads(frame["observables"][0]).items() if value is None]
    assert table(runs)[unseen].isna().all(axis=None)


def test_a_store_that_is_damaged_or_of_another_version_is_named(study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs = study_file(SPEEDS.format(2), "verlet"), tmp_path / "runs"
    runs.mkdir()
    (runs / "batch.sqlite").write_bytes(b"no database" * 1000)
    refused = beads("status", path, "--runs", runs)
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert f"{runs / 'batch.sqlite'}: found a damaged file (file is not a database)" in refused.stderr
    (runs / "batch.sqlite").unlink()
    with closing(sqlite3.connect(runs / "batch.sqlite")) as connection:
        connection.execute("PRAGMA user_version = 7")
    refused = batch(path, runs)
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "rows of version 7 of the store; allowed: version 1" in refused.stderr


ROW = StudyRow("case", "verlet", "program", "study", "label", "build", 5.0, "done")


def test_a_row_done_takes_precedence_over_a_later_failure(tmp_path: Path) -> None:
    failed = replace(ROW, status="failed", reason="killed", ended=6.0)
    with Store(tmp_path) as store:
        for row in (failed, ROW, failed):
            store.finish(row)
        assert store.rows(["case"], {}) == {("case", "verlet"): ROW}
        store.finish(replace(failed, program="next", ended=4.0))  # although the clock was set back
        assert store.rows(["case"], {})["case", "verlet"].program == "next"


def test_the_database_appears_when_it_is_complete(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes that make it at the same time share that of the first."""
    link = os.link

    def of_a_slow_process(draft: Path, file: Path) -> None:
        assert not file.exists()
        monkeypatch.setattr(os, "link", link)
        with Store(tmp_path / "runs") as first:
            first.finish(ROW)
        link(draft, file)

    monkeypatch.setattr(os, "link", of_a_slow_process)
    with Store(tmp_path / "runs") as store:
        store.finish(replace(ROW, case_sha256="other"))
        assert store.rows(["case"], {}) == {("case", "verlet"): ROW}
    assert os.link is link
    assert [file.name for file in (tmp_path / "runs").iterdir()] == ["batch.sqlite"]


def test_a_file_system_without_hard_links_holds_a_database(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Path) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "link", refuse)
    with Store(tmp_path / "runs") as store:
        store.finish(ROW)
    assert stored(tmp_path / "runs") == [1]


def test_claims_end_with_their_process(tmp_path: Path) -> None:
    init, used_again = (
        f"{platform.node()} 1 {psutil.Process(1).create_time()} 0",
        f"{platform.node()} {os.getpid()} 0.0 0",
    )
    with Store(tmp_path) as store, Store(tmp_path) as of_another_thread:
        store.claim(["a", "b"], ["verlet"])
        of_another_thread.claim(["b", "d"], ["verlet"])
        assert store.claimed() == {("d", "verlet")}
        for owner, claimed in ((init, {("a", "verlet")}), (used_again, set())):
            sql(tmp_path, "UPDATE claims SET owner = ? WHERE case_sha256 = 'a'", owner)
            assert store.claimed() == claimed | {("d", "verlet")}
        for since, claimed in ((time.time(), {("a", "verlet")}), (0.0, set())):
            sql(tmp_path, "UPDATE claims SET owner = 'elsewhere 1 0.0 0', since = ? WHERE case_sha256 = 'a'", since)
            assert store.claimed() == claimed | {("d", "verlet")}
        store.finish(replace(ROW, case_sha256="a"))
        store.__exit__()
        assert sql(tmp_path, "SELECT case_sha256 FROM claims") == [("d",)]
    assert sql(tmp_path, "SELECT case_sha256 FROM claims") == []


def test_a_row_that_another_batch_finishes_meanwhile_is_not_run_again(
    study_file: StudyWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is finished between the looks of this batch at rows and claims, whichever comes first."""
    asked = batch_rows.Batch(study_file(SPEEDS.format(2), "verlet"), tmp_path)
    (of_case,) = asked.study.digests([1])
    with Store(tmp_path) as store, Store(tmp_path) as other:
        other.claim([of_case], ["verlet"])
        assert asked.states(store, [1])["verlet"] == {1: "claimed"}
        for name in ("states", "claimed"):
            look = getattr(store, name)

            def look_and_meanwhile(*words: Any, look: Any = look) -> Any:
                found = look(*words)
                other.finish(replace(ROW, case_sha256=of_case, program=asked.programs["verlet"]))
                return found

            monkeypatch.setattr(store, name, look_and_meanwhile)
        assert asked.states(store, [1])["verlet"] == {1: "done"}


def test_a_database_that_cannot_be_written_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also with rows that a killed process has not moved from the log."""
    with Store(tmp_path / "a#b?") as store:
        store.finish(ROW)
        shutil.copytree(store.runs, tmp_path / "killed")
    monkeypatch.setattr(os, "access", lambda *_: False)
    for runs in (store.runs, tmp_path / "killed"):
        with Store(runs) as of_another:
            assert of_another.rows(["case"], {}) == {("case", "verlet"): ROW}


def test_processes_on_a_network_write_databases_of_their_own(
    study_file: StudyWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All are read; the next batch merges those of processes that have ended."""
    path, runs = study_file(SPEEDS.format(4), "verlet"), tmp_path / "runs"
    assert batch_store.is_shared(tmp_path)
    monkeypatch.setattr(batch_store, "is_shared", lambda runs: False)
    assert batch(path, runs, "--slice", "1/2").returncode == 0
    (own,) = runs.glob("*.sqlite")
    own.rename(runs / f"batch-{platform.node()}-{2**22 + 1}.sqlite")  # of a process that cannot be
    assert batch(path, runs, "--slice", "2/2").returncode == 0
    assert beads("status", path, "--runs", runs).stdout == "verlet  4 done\n"
    assert len([*runs.iterdir()]) == 2
    assert batch(path, runs).returncode == 0
    assert len(stored(runs)) == 2
    shutil.copy(runs / "batch.sqlite", runs / "batch-old.sqlite")  # of the user, who put it aside
    assert batch(path, runs).returncode == 0
    (runs / "batch-old.sqlite").unlink()
    assert {file.name for file in runs.iterdir()} == {"batch.sqlite", f"batch-{platform.node()}-{os.getpid()}.sqlite"}
    assert set(table(runs)["status"]) == {"done"}


@pytest.mark.long
def test_cases_of_one_process_are_bit_identical_to_single_runs(scene_file: SceneWriter, tmp_path: Path) -> None:
    engines = ["reference", "verlet", "liggghts", "yade"]
    for name in engines:
        need(name)
    scene_file()
    path, runs = tmp_path / "study.toml", tmp_path / "runs"
    strikers = (
        '{ shape = "flat", material = "alumina", mass = "0.47 g", speed = "0.4 m/s" },'
        ' { material = "ptfe", diameter = "4.76 mm", speed = "1 m/s" }'
    )
    path.write_text(
        f'scene = "scene.toml"\nengines = {engines}\nset = {{ "chain.mass_scatter" = "1 mg" }}\n'
        f'[[axis]]\nkey = "wall"\nvalues = ["", {{ material = "brass" }}]\n[[axis]]\nkey = "striker"\n'
        f'values = [{strikers}]\n[[axis]]\nkey = "gravity"\nvalues = ["0 m/s^2", "9.81 m/s^2"]'
    )
    done = batch(path, runs, "--workers", "1")
    assert done.returncode == 0, done.stderr
    for number in (4, 8):
        shown = beads("show", path, str(number), "--runs", runs)
        assert shown.returncode == 0, shown.stdout + shown.stderr
        assert shown.stdout.count("as in the batch, bit for bit") == 4, shown.stdout
    folder = Path(next(line for line in shown.stdout.splitlines() if "yade" in line).split("  ")[0])
    assert {"chain.py", "forces.parquet", "sensors.csv", "run.json"} <= {file.name for file in folder.iterdir()}


# a script in place of LIGGGHTS that is killed at the deck of one case, as a server and by itself
KILLED = """case "$*" in *-help*) exec {real} "$@";; esac
[ ! -e {repaired} ] && [ -e chain.data ] && grep -q -- " -1 0 0 0" chain.data && kill -SEGV $$
fifo=$(mktemp -u); mkfifo $fifo; exec 3<&0
(while IFS= read -r line; do
  [ ! -e {repaired} ] && [ "$line" = "include chain.in" ] && grep -q -- " -1 0 0 0" case/chain.data && kill -SEGV $$
  echo "$line"
done <&3) > $fifo &
exec {real} "$@" < $fifo
"""


def test_a_failure_is_charged_to_its_case_and_not_run_again(
    study_file: StudyWriter, stand_in: StandIn, tmp_path: Path
) -> None:
    need("liggghts")
    path, runs, repaired = study_file(SPEEDS.format(4), "liggghts"), tmp_path / "runs", tmp_path / "repaired"
    stand_in("liggghts", KILLED.format(real=shutil.which("liggghts"), repaired=repaired))
    done = batch_here(path, runs)
    assert done.returncode == 1
    reason, last = done.stderr.splitlines()[-2:]
    assert "killed by signal 11" in reason
    assert last == "failed rows: 1; --retry runs them again"
    failed = table(runs)
    assert list(failed["status"]) == ["done", "failed", "done", "done"]
    assert stored(runs) == [1, 2, 3, 4]
    repaired.touch()
    assert "liggghts  3 done, 1 failed\n" in batch(path, runs, "--dry-run").stdout
    assert "liggghts  3 done, 1 to do\nexpected time: " in batch(path, runs, "--dry-run", "--retry").stdout
    assert batch_here(path, runs, "--retry").returncode == 0
    assert failed.iloc[[0, 2, 3]].equals(table(runs).iloc[[0, 2, 3]])
    assert set(table(runs)["status"]) == {"done"}
    assert stored(runs) == [1, 3, 4, 5]


def test_an_unstable_case_is_refused_or_fails_alone(study_file: StudyWriter, tmp_path: Path) -> None:
    axes = '[[axis]]\nzip = { "run.time_step" = ["0.1 us", "25 us"], "run.sample_interval" = ["1 us", "25 us"] }'
    refused = batch_here(study_file(axes, "verlet", "reference"), tmp_path / "runs")
    assert refused.returncode == 2
    assert "case 2 (" in refused.stderr
    assert "run.time_step: found 2.5e-05 s; allowed: at most" in refused.stderr
    assert list(table(tmp_path / "runs")["status"]) == ["done", "done", "refused", "done"]
    done = batch_here(study_file(axes, "verlet", "reference", top="unsafe = true"), tmp_path / "runs")
    assert done.returncode == 1
    assert "unstable at t = " in done.stderr
    assert list(table(tmp_path / "runs")["status"]) == ["done", "done", "failed", "done"]


def test_rows_of_a_changed_template_build_or_source_are_stale(
    study_file: StudyWriter, stand_in: StandIn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need("lammps")
    path, runs = study_file('[[axis]]\nkey = "chain.count"\nvalues = [3, 4]', "verlet", "lammps"), tmp_path / "runs"

    def status() -> str:
        return beads("status", path, "--runs", runs).stdout

    monkeypatch.setattr(paths, "TEMPLATES", shutil.copytree(paths.TEMPLATES, tmp_path / "templates"))
    assert batch(path, runs, "--slice", "1/1").returncode == 0
    assert status() == "verlet  2 done\nlammps  2 done\n"
    template = tmp_path / "templates" / "lammps" / "chain.in.j2"
    text = template.read_text()
    template.write_text(f"{text}# another line\n")
    assert status() == "verlet  2 done\nlammps  2 stale\n"
    template.write_text(text)
    assert status() == "verlet  2 done\nlammps  2 done\n"
    stand_in("lmp", f'exec {shutil.which("lmp")} "$@"\n')  # another build
    assert status() == "verlet  2 done\nlammps  2 stale\n"
    monkeypatch.setattr(batch_rows, "digest_of_sources", lambda: "another")
    assert status() == "verlet  2 stale\nlammps  2 stale\n"


def test_an_open_temporary_folder_is_not_the_fault_of_the_rows(study_file: StudyWriter, tmp_path: Path) -> None:
    need("lammps")
    place, runs = tmp_path / "open", tmp_path / "runs"
    place.mkdir()
    place.chmod(0o777)
    done = beads_process("batch", study_file(SPEEDS.format(2), "lammps"), "--runs", runs, TMPDIR=str(place))
    assert done.returncode == 2
    assert done.stderr.startswith(f"TMPDIR={place}: found a folder in which others can replace files; allowed: ")
    assert not stored(runs)


@pytest.mark.long
def test_two_simultaneous_batches_share_the_work(study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs = study_file(SPEEDS.format(100), "verlet", "reference"), tmp_path / "runs"
    words = [*BEADS, "batch", str(path), "--runs", str(runs)]
    results = [tmp_path / "one", tmp_path / "two"]
    both = [subprocess.Popen([*words, "--results", str(place)], stdout=subprocess.DEVNULL) for place in results]
    assert [process.wait(120) for process in both] == [0, 0]
    assert results[0].joinpath("study.parquet").read_bytes() == results[1].joinpath("study.parquet").read_bytes()
    assert stored(runs) == [*range(1, 201)]


def test_rows_without_a_reference_run_are_tried_again(study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs = study_file(SPEEDS.format(2), "verlet", top='limit = "1 us"'), tmp_path / "runs"
    assert batch_here(path, runs).returncode == 1
    assert set(table(runs)["status"]) == {"timeout"}
    path.write_text(path.read_text().replace("1 us", "60 s"))
    assert batch_here(path, runs).returncode == 1
    assert batch_here(path, runs, "--retry").returncode == 0
    assert table(runs)["force_error_share"].notna().all()


def test_observables_that_rows_do_not_show_are_counted(study_file: StudyWriter, tmp_path: Path) -> None:
    axes = (
        '[[axis]]\nkey = "run.duration"\nvalues = ["20 us", "0.3 ms"]\n'
        '[[axis]]\nkey = "chain.sensors"\nvalues = [[], [{ from_wall = 3 }]]'
    )
    path, runs = study_file(axes, "verlet", "reference", top='observables = ["*_peak_N", "wal_*"]'), tmp_path / "runs"
    lines = [
        "wall_peak_N: not seen in 4 of 8 rows: the gauge shows no pulse before the end of the run",
        "bead_3_peak_N: not seen in 2 of 8 rows: the gauge shows no pulse before the end of the run",
        "bead_3_peak_N: not in 4 of 8 rows: their scenes have no such gauge",
    ]
    for _ in range(2):  # the second batch runs no case
        done = batch_here(path, runs)
        assert [line for line in done.stdout.splitlines() if ": not " in line] == lines
        assert (done.returncode, done.stderr) == (1, f'{path}: observables: "wal_*" matches no observable\n')
        assert [*table(runs).columns[-2:]] == ["wall_peak_N", "bead_3_peak_N"]


def test_a_study_run_from_a_path_is_found_by_its_name(
    study_file: StudyWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    study, runs = study_file(SPEEDS.format(2), "verlet"), ("--runs", tmp_path / "runs")
    assert beads("batch", study, *runs, "--results", tmp_path / "results").returncode == 0
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert beads("status", study.stem, *runs).stdout == "verlet  2 done\n"
    assert beads("show", study.stem, "2", *runs).returncode == 0
    assert len(read_study_table(study.stem, tmp_path / "runs")) == 2
    study.unlink()
    assert "study.toml: file not found" in beads("status", study.stem, *runs).stderr
