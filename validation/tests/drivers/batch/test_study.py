"""Tests of study files: forms of axes, and errors."""

import pickle
import sys
from pathlib import Path

import pytest

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.batch.study import column_name, in_si, read_study, select
from drivers.engines import engine_names
from drivers.scene.settings import look_up
from validation.commands.batch_commands import batch_of
from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import SceneWriter, StudyWriter


@pytest.fixture
def write(study_file: StudyWriter) -> StudyWriter:
    """Writes a study on the reference."""
    return lambda axes, top="": study_file(axes, "reference", top=top)


def choices(path: Path) -> list[dict[str, object]]:
    study = read_study(path)
    return [study.choice(number) for number in range(1, study.count + 1)]


def test_a_grid_varies_the_last_axis_fastest_and_one_by_one_begins_with_the_base(write: StudyWriter) -> None:
    axes = '[[axis]]\nkey = "chain.count"\nvalues = [3, 4]\n[[axis]]\nseeds = 2'
    assert [[*each.values()] for each in choices(write(axes))] == [[3, 1], [3, 2], [4, 1], [4, 2]]
    one_by_one = choices(write(axes, 'combine = "one by one"'))
    assert one_by_one == [{}, {"chain.count": 3}, {"chain.count": 4}, {"seed": 1}, {"seed": 2}]


@pytest.mark.parametrize(
    ("key", "ends", "expected"),
    [
        ("striker.speed", 'from = "1 m/s"\nto = "300 cm/s"\ncount = 3', ["1.0 m/s", "2.0 m/s", "3.0 m/s"]),
        ("chain.count", 'from = 1\nto = 100\ncount = 9\nspacing = "log"', [1, 2, 3, 6, 10, 18, 32, 56, 100]),
        ("chain.count", "from = 5\nto = 1\ncount = 3\nvalues = [2, 3, 8]", [8, 5, 3, 2, 1]),
        (
            "striker.speed",
            'from = "0.1 m/s"\nto = "1 m/s"\ncount = 2\nvalues = ["50 cm/s", "1.0 m/s"]',
            ["0.1 m/s", "50 cm/s", "1.0 m/s"],
        ),
    ],
)
def test_ranges_of_quantities_and_of_whole_numbers(
    write: StudyWriter, key: str, ends: str, expected: list[object]
) -> None:
    assert [choice[key] for choice in choices(write(f'[[axis]]\nkey = "{key}"\n{ends}'))] == expected


def test_factors_of_the_base_and_of_the_library(write: StudyWriter) -> None:
    axes = (
        '[[axis]]\nkey = ["striker.speed", "chain.diameter"]\nname = "x"\nfactors = [2]\n'
        '[[axis]]\nkey = "materials.ptfe.youngs_modulus"\nfactors = [0.5]\n[[axis]]\nkey = "chain.count"\nfactors = [2]'
    )
    path = write(axes)
    scene = read_study(path).case(1).scene
    assert scene.striker is not None
    assert (scene.striker.speed, scene.chain.diameter, scene.chain.count) == (2.0, 0.00952, 10)
    assert scene.materials["ptfe"].youngs_modulus == 0.73e9
    assert scene.materials["ptfe"].poisson_ratio == 0.46
    assert list(read_study(path).columns) == ["x", "materials.ptfe.youngs_modulus", "chain.count"]


def test_zipped_keys_and_a_table(write: StudyWriter, tmp_path: Path) -> None:
    (tmp_path / "cases.csv").write_text("striker.speed [cm/s],wall.material\n150,rigid\n2e2,steel\n")
    pairs = '{ "chain.count" = [3, 9], "run.duration" = ["0.2 ms", "0.4 ms"] }'
    study = read_study(write(f'[[axis]]\nzip = {pairs}\n[[axis]]\ntable = "cases.csv"'))
    keys = ("chain.count", "run.duration", "striker.speed", "wall.material")
    assert [[look_up(study.case(number).scene, key) for key in keys] for number in range(1, 5)] == [
        [3, 0.0002, 1.5, "rigid"],
        [3, 0.0002, 2.0, "steel"],
        [9, 0.0004, 1.5, "rigid"],
        [9, 0.0004, 2.0, "steel"],
    ]


def test_a_key_may_be_left_out_and_set_for_all(write: StudyWriter) -> None:
    axes, top = '[[axis]]\nkey = "wall"\nvalues = ["", { material = "steel" }]', 'set = { gravity = "1 m/s^2" }'
    study = read_study(write(axes, top))
    assert [study.case(n).chain.wall for n in (1, 2)] == [None, "steel"]
    assert study.case(1).scene.gravity == 1.0


def test_columns_tell_units_and_values_are_in_si(write: StudyWriter) -> None:
    keys = {
        "striker.speed": "striker.speed_m_s",
        "materials.ptfe.density": "materials.ptfe.density_kg_m3",
        "chain.sensors.0.mass": "chain.sensors.0.mass_kg",
        "chain.count": "chain.count",
        "wall": "wall",
    }
    assert {key: column_name(key, key) for key in keys} == keys
    scene = read_study(write('[[axis]]\nkey = "striker.speed"\nvalues = ["150 cm/s"]')).case(1).scene
    assert look_up(scene, "striker.speed") == 1.5
    assert look_up(scene, "chain.sensors.3.mass") is None
    assert in_si("wall", scene.wall) == '{"material": "brass"}'


def test_selection(write: StudyWriter) -> None:
    counts, walls = '"chain.count"\nvalues = [3, 4, 30]', '"wall.material"\nvalues = ["brass", "steel"]'
    axes = f"[[axis]]\nkey = {counts}\n[[axis]]\nkey = {walls}"
    study = read_study(write(axes))
    assert list(select(study, ())) == [1, 2, 3, 4, 5, 6]
    assert select(study, ["chain.count=3*"]) == [1, 2, 5, 6]
    assert select(study, ["chain.count=3", "chain.count=4", "wall.material=st*"]) == [2, 4]
    assert select(study, ["*steel"]) == [2, 4, 6]
    with pytest.raises(InputError, match="matches no case"):
        select(study, ["chain.count=5"])
    assert read_study(write(axes), ["yade"]).engines == (*study.engines, "yade")


SPEED, COUNT = '[[axis]]\nkey = "striker.speed"\n', '[[axis]]\nkey = "chain.count"\n'
BAD = {
    "a key near that of a file": (
        '[[axis]]\nkey = "chain.count"\nfrom_ = 3',
        "axis.0.from_: unknown key; did you mean from?",
    ),
    "no such key": ('[[axis]]\nkey = "striker.colour"\nvalues = ["red"]', "striker.colour: unknown key; allowed: "),
    "an empty axis": (f"{COUNT}values = []", "axis.0.values: found 0 of chain.count"),
    "no form": (COUNT, "exactly one of values, factors, zip, seeds, table, or from with to"),
    "two forms": (f"{COUNT}values = [1]\nseeds = 2", "found values, seeds"),
    "a key too many": (f"{COUNT}seeds = 2", "no key with seeds"),
    "a value of another kind": (
        f'{SPEED}from = "1 m/s"\nto = "2 m/s"\ncount = 3\nvalues = ["fast"]',
        "1 m/s, 2 m/s, fast",
    ),
    "a key that was meant": (f"{COUNT}form = 1\nto = 2\ncount = 3", "axis.0.form: unknown key; did you mean from?"),
    "no count": (f"{COUNT}from = 1\nto = 2", "axis.0: found from, to; allowed: exactly one of values"),
    "units apart": (f'{SPEED}from = "1 m/s"\nto = "2 kg"\ncount = 3', "numbers, or quantities of one kind"),
    "log of nothing": (
        f'{COUNT}from = 0\nto = 9\ncount = 3\nspacing = "log"',
        "finite, above zero",
    ),
    "NaN": (f"{COUNT}from = nan\nto = 2\ncount = 3", "; finite"),
    "an endless number": (f'[[axis]]\nkey = "seed"\nfrom = {"9" * 400}\nto = 2\ncount = 2', "; finite"),
    "lists of unlike lengths": ('[[axis]]\nzip = { "chain.count" = [1, 2], "seed" = [1] }', "2 of chain.count, 1 of"),
    "a key twice": ('[[axis]]\nkey = "seed"\nvalues = [1]\n[[axis]]\nseeds = 2', "seed, which overlaps seed of axis.0"),
    "a key also set": (
        f'set = {{ striker = "" }}\n{SPEED}values = ["1 m/s"]',
        "striker.speed, which overlaps striker of set",
    ),
    "a factor of nothing": ('[[axis]]\nkey = "chain.precompression"\nfactors = [2]', "nothing at chain.precompression"),
    "a factor of a word": ('[[axis]]\nkey = "wall.material"\nfactors = [2]', '"brass" at wall.material'),
    "a device as table": ('[[axis]]\ntable = "/dev/zero"', "/dev/zero: found no regular file; allowed: a CSV"),
    "a word in the table": ('[[axis]]\ntable = "word.csv"', 'line 3, striker.speed: found "fast"; allowed: a plain'),
    "a ragged table": ('[[axis]]\ntable = "ragged.csv"', "the number of columns changed from 2 to 1 at row 2"),
    "an empty table": ('[[axis]]\ntable = "empty.csv"', "at least one line of values"),
    "a scene that cannot be": (f"{COUNT}values = [3, -1]", "case 2 (chain.count=-1): chain.count: found -1"),
    "an unknown engine": ('engines = ["abaqus"]', f'"abaqus"; allowed: {", ".join(engine_names())}'),
    "no base scene": ('scene = "nowhere"', 'scene: found "nowhere"'),
    "a name that is taken": ('[[axis]]\nkey = "seed"\nname = "case"\nvalues = [1]', '"case", the name of another'),
    "all problems": (f'engines = ["abaqus"]\n{COUNT}{COUNT}', ": 3 problems: (1) axis.0: "),
    "a line of too many cells": (
        '[[axis]]\ntable = "wide.csv"',
        "2 lines of 100000 cells; allowed: a CSV file: a line of at",
    ),
    "a million cases": (
        f"[[axis]]\nseeds = 1000\n{COUNT}from = 1\nto = 1000\ncount = 1000",
        "1,000,000 cases; allowed: at most 20,000, or --yes",
    ),
    "a name that is another with its unit": (
        f'{SPEED}name = "a"\nvalues = ["1 m/s"]\n{COUNT}name = "a_m_s"\nvalues = [3]',
        'axis.1.name: found "a_m_s", the name of another column',
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_studies(name: str, scene_file: SceneWriter, tmp_path: Path) -> None:
    scene_file()
    (tmp_path / "word.csv").write_text("striker.speed [m/s]\n1\nfast\n")
    (tmp_path / "ragged.csv").write_text("striker.speed [m/s],chain.count\n1\n")
    (tmp_path / "wide.csv").write_text(f"{','.join(f'k{i}' for i in range(100_000))}\n1\n")
    (tmp_path / "empty.csv").write_text("striker.speed [m/s]\n")
    text, words = BAD[name]
    top = "".join(
        f"{line}\n" for line in ('scene = "scene.toml"', 'engines = ["reference"]') if line.split()[0] not in text
    )
    path = tmp_path / "study.toml"
    path.write_text(top + text)
    refused = beads("batch", path, "--runs", tmp_path / "runs", "--results", tmp_path, "--dry-run")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert words in refused.stderr
    assert not (tmp_path / "runs").exists()


def test_no_column_has_the_name_of_an_observable(write: StudyWriter, tmp_path: Path) -> None:
    path = write(f'{COUNT}name = "wall_peak_N"\nvalues = [3]')
    refused = beads("batch", path, "--runs", tmp_path / "runs")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert '"wall_peak_N", the name of an observable' in refused.stderr
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--slice", "0/2"], "I/N with I from 1 to N"),
        (["--workers", "0"], "'--workers': 0 is not in the range 1<=x"),
        (["--dask", "carrier pigeon"], "no scheduler answers"),
        (["--dask"], "make cluster"),
        (["--slurm", "--dask"], "--slurm: not allowed with --dask"),
        (["--slurm", "--slice", "1/2"], "--slurm: not allowed with --slice"),
        (["--slice", "1/2", "--dry-run"], "not allowed with --slice"),
        (["--slice", "1/2", "--workers", "2"], "--workers: not allowed with --slice"),
        (["--slurm"], "--slurm: sbatch not found; run this on a machine that submits to Slurm"),
        (["--wait"], "needs --slurm"),
        (["--engine", "nix"], "reference, verlet"),
        (["--only", "seed=9"], "matches no case"),
    ],
)
def test_bad_options(
    words: list[str], message: str, study_file: StudyWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    if words == ["--dask"]:
        monkeypatch.setitem(sys.modules, "distributed", None)
    path = study_file("[[axis]]\nseeds = 3", "reference")
    done = beads("batch", path, "--runs", tmp_path / "runs", "--results", tmp_path / "results", *words)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
    assert message in done.stderr
    assert "--dask" not in words or not (tmp_path / "runs").exists()


@pytest.mark.long
@pytest.mark.parametrize("path", sorted(paths.STUDIES.glob("*.toml")), ids=lambda path: path.stem)
def test_shipped_studies_are_valid(path: Path, tmp_path: Path) -> None:
    done = beads("batch", path, "--runs", tmp_path / "runs", "--dry-run")
    assert (done.returncode, " checked\n" in done.stdout) == (0, True)


def test_processes_with_another_working_folder_read_the_same_study(
    write: StudyWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as idle ones of a notebook that has changed its folder."""
    path = write('[[axis]]\nkey = "chain.count"\nvalues = [3, 4]')
    monkeypatch.chdir(path.parent)
    sent = pickle.dumps(batch_of(path.name, tmp_path / "runs"))
    monkeypatch.chdir("/")
    assert pickle.loads(sent).study.name == path.stem
