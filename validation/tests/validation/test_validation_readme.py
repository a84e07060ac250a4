"""The README of the package: commands parse, the example runs, numbers are those of the files and of the code."""

import re
from math import acos, exp, sqrt, tan

import pytest

from drivers.base import paths
from drivers.chain.schemes import verlet_of
from drivers.laws.viscoelastic import damping_ratio, restitution, restitution_with_attraction
from drivers.limits.stable_step import predicted_limit
from postproc.paper.calibrated import calibrated
from validation.accuracy.exact_motion import errors_of, exact_motion_of
from validation.accuracy.plan import planned_case
from validation.chapters import CHAPTERS, load_chapter
from validation.reference.travelling_wave import solve_travelling_wave
from validation.stability.extremes import extremes
from validation.tests.engine.candidate import kit
from validation.tests.helpers.readme import command_lines, parse
from validation.trade.ladder import SCENES, SHARES

README = paths.ROOT / "validation" / "README.md"
TEXT = README.read_text()
FOLDERS = [path.name for path in README.parent.iterdir() if path.is_dir() and not path.name.startswith(("_", "."))]


@pytest.mark.parametrize("line", command_lines(README))
def test_commands_parse(line: str) -> None:
    parse(line)


@pytest.mark.parametrize("folder", FOLDERS)
def test_folders_are_in_the_table(folder: str) -> None:
    assert f"| `{folder}/` |" in TEXT


def test_named_files_exist() -> None:
    for name in set(re.findall(r"`((?:inputs|tests|independent)/[\w/]+\.\w+)`", TEXT)):
        assert (paths.ROOT / name).exists() or (README.parent / name).exists(), name


def test_named_tables_are_written_by_studies() -> None:
    tables = {f"{name}.csv" for study in CHAPTERS for name in load_chapter(study).tables}
    named = set(re.findall(r"([\w-]+\.csv)`", TEXT)) - {"fit-SCENE.csv", "-data.csv"}
    assert named <= tables


def test_targets_are_those_of_make() -> None:
    known = re.findall(r"^\.PHONY: (.*)$", (paths.ROOT / "Makefile").read_text(), re.MULTILINE)
    targets = {*" ".join(known).split(), *CHAPTERS}
    assert set(re.findall(r"(?:^|`)make ([\w-]+)", TEXT, re.MULTILINE)) <= targets


def test_the_example_prints_its_number(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(r"^```python\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
    exec(example, {})
    (stated,) = re.findall(r"# ([\d.]+ N)$", example, re.MULTILINE)
    assert capsys.readouterr().out == f"{stated}\n"


def test_counts_are_those_of_the_files() -> None:
    assert f"holds {len(extremes())} extreme scenes" in TEXT
    assert f"{len(kit()['variant'])} scenes" in TEXT
    assert f"of the report's five chapters ({', '.join(CHAPTERS)})" in TEXT
    assert len(SCENES) == 7
    assert min(SHARES) == pytest.approx(1e-4)


@pytest.mark.parametrize(
    ("settings", "stated"),
    [
        ((), "3.0e-5 elastic"),
        (("contact.restitution=0.9",), "1.0e-3 at e = 0.9"),
        (("contact.dissipation=power", "contact.gamma=3"), "5.2e-3 at gamma = 3"),
    ],
)
def test_errors_of_the_time_step(settings: tuple[str, ...], stated: str) -> None:
    case = planned_case("fig4", *settings)
    error = errors_of(case, verlet_of(case), exact_motion_of(case), ("force",))["force"]
    assert stated in TEXT
    assert error == pytest.approx(float(stated.split()[0]), rel=0.03)


def test_limit_and_planned_step_of_fig4() -> None:
    case = planned_case("fig4")
    assert f"{1e6 * predicted_limit(case.chain, float(case.sample_times_s[-1])):.1f} µs for Fig. 4" in TEXT
    planned = planned_case("fig4", "run.time_step=", "run.accuracy=1e-4")
    assert "1/6 µs for Fig. 4 at 1e-4" in TEXT
    assert planned.scene.time_step_s == pytest.approx(1e-6 / 6)


def test_restitution() -> None:
    a = acos(sqrt(6 / 5) * 0.0313)
    assert exp(-2 * a / tan(a)) == pytest.approx(restitution(0.0313), rel=1e-12)
    assert restitution(0.0313) == pytest.approx(0.9, abs=1e-4)
    assert f"{restitution_with_attraction(damping_ratio(0.9)):.4f} for e = 0.9" in TEXT


def test_constants_and_calibrated_values() -> None:
    assert f"c = {solve_travelling_wave().speed_by_force:.4f} k^(1/3)" in TEXT
    modulus, restitution_ = (each.value for each in calibrated().parameter)
    bounds = calibrated().parameter[0]
    assert f"{bounds.low * 1e-9:.2f} to {bounds.high * 1e-9:.2f} GPa" in " ".join(TEXT.split())
    assert f"({modulus * 1e-9:.2f} GPa, restitution {restitution_:.2f})" in " ".join(TEXT.split())
