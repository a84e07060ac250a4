"""The READMEs: commands parse, links and targets exist, folders are listed, the examples run."""

import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pandas as pd
import pytest

from drivers.base import paths
from postproc.draw.plot import pyplot
from validation.chapters import CHAPTERS
from validation.tests.helpers.commands import beads
from validation.tests.helpers.readme import command_lines, parse
from validation.tests.helpers.runs import need

README = paths.ROOT / "README.md"
READMES = [README, *(paths.ROOT / name / "README.md" for name in ("inputs", "drivers", "postproc", "validation"))]
TEXT = README.read_text()
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
(SCENE,) = (block for language, block in BLOCKS if language == "toml")
EXAMPLES = [block for _, block in BLOCKS if "steel.toml" in block]

TWO = """
[chain]
count = 1
material = "ptfe"
diameter = "4.76 mm"
[striker]
material = "ptfe"
diameter = "4.76 mm"
speed = "1 m/s"
[run]
duration = "100 us"
sample_interval = "1 us"
time_step = "0.1 us"
"""
BEADS_DATA = """two beads

2 atoms
1 atom types
-0.01 0.01 xlo xhi
-0.01 0.01 ylo yhi
-0.01 0.02 zlo zhi

Atoms

1 1 0.00476 2200 0 0 0.00238
2 1 0.00476 2200 0 0 0.00714

Velocities

1 0 0 0 0 0 0
2 0 0 -1 0 0 0
"""


@pytest.mark.parametrize("line", sorted({line for readme in READMES for line in command_lines(readme)}))
def test_commands_parse(line: str) -> None:
    parse(line)


@pytest.mark.parametrize("line", ["beads walk fig4", "beads run fig4 --fast"])
def test_unknown_commands_and_options_do_not_parse(line: str) -> None:
    with pytest.raises(AssertionError):
        parse(line)


@pytest.mark.parametrize("readme", READMES, ids=lambda readme: readme.parent.name)
def test_links_lead_to_a_file_or_a_heading_and_targets_exist(readme: Path) -> None:
    text = readme.read_text()
    for link, anchor in re.findall(r"\]\(([^)#]*)#?([^)]*)\)", text):
        target = (readme.parent / link).resolve() if link else readme
        assert target.exists(), link
        headings = re.findall(r"^#+ (.*)$", target.read_text(), re.MULTILINE) if anchor else []
        assert anchor in ["", *(re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in headings)], anchor
    known = re.findall(r"^\.PHONY: (.*)$", (paths.ROOT / "Makefile").read_text(), re.MULTILINE)
    figures = [path.stem for path in (paths.ROOT / "postproc" / "figures").glob("[a-z]*.py")]
    assert set(re.findall(r"(?:^|`)make ([\w-]+)", text, re.MULTILINE)) <= {
        *" ".join(known).split(),
        *figures,
        *CHAPTERS,
    }


@pytest.mark.parametrize("package", ["drivers", "postproc", "validation"])
def test_folders_of_packages_are_listed(package: str) -> None:
    folders = {path.name for path in (paths.ROOT / package).iterdir() if path.is_dir() and path.name[0] not in "._"}
    listed = re.findall(r"^\| `(\w+)/` \|", (paths.ROOT / package / "README.md").read_text(), re.MULTILINE)
    assert set(listed) == folders


def typed(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Type a line into a shell that has entered the environment."""
    return subprocess.run(
        ["bash", "-c", f". .venv/bin/activate\n{line}"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
        env=os.environ | {"MPLBACKEND": "Agg"},
    )


@pytest.mark.long
def test_the_worked_example_runs_line_by_line(tmp_path: Path) -> None:
    (tmp_path / ".venv").symlink_to(sys.prefix)
    (tmp_path / "steel.toml").write_text(SCENE)
    lines = [line for block in EXAMPLES for line in block.splitlines()]
    assert len(lines) > 6
    printed = {}
    for line in lines:
        ended = typed(line, tmp_path)
        assert ended.returncode == 0, f"{line}\n{ended.stdout}\n{ended.stderr}"
        printed[line.partition(" #")[0].strip()] = ended.stdout
    assert "speed_7_to_3_m_s" in printed["beads observables yade:steel"]
    assert "FAIL" not in printed["beads compare steel.toml"]
    assert "Ten steel beads" in (tmp_path / "steel.html").read_text()
    (stated,) = re.findall(r"`(steel.toml: [^`]+)`", TEXT)
    (tmp_path / "steel.toml").write_text(SCENE.replace("\nspeed", "\nsped"))
    ended = typed("beads plan steel.toml", tmp_path)
    assert (ended.returncode, ended.stderr.splitlines()[-1]) == (2, stated)


def test_the_figure_of_one_s_own_is_made(tmp_path: Path) -> None:
    (example,) = re.findall(r"```py\n(.*?)```", (paths.ROOT / "postproc" / "README.md").read_text(), re.DOTALL)
    assert len(example.split("\n")) < 16
    file = tmp_path / "my_figure.py"
    file.write_text(example)
    done = beads("figures", file, "--runs", tmp_path / "runs", "--results", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (tmp_path / "out").iterdir()} == {f"my_figure.{end}" for end in ("csv", "png", "svg")}
    wave = pd.read_csv(tmp_path / "out" / "my_figure.csv")["wave_m_s"]
    assert wave.is_monotonic_increasing


def test_the_deck_of_one_s_own_is_judged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    need("lammps")
    text = (paths.ROOT / "drivers" / "README.md").read_text()
    (deck,) = re.findall(r"```\n(units .*?)```", text, re.DOTALL)
    (line,) = re.findall(r"^(beads import --dump .*)$", text, re.MULTILINE)
    monkeypatch.chdir(tmp_path)
    Path("in.own").write_text(deck)
    Path("two.toml").write_text(TWO)
    Path("beads.data").write_text(BEADS_DATA)
    subprocess.run(("lmp", "-in", "in.own"), capture_output=True, check=True)
    done = beads(*shlex.split(line)[1:], "--runs", tmp_path / "runs")
    assert done.returncode == 0, done.stderr
    assert re.search(r"the forces are those of its scheme to \d\.\de-0[78] of", done.stderr)


@pytest.mark.long
def test_python_examples_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runs, results = tmp_path / "runs", tmp_path / "results"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(paths, "RUNS", runs)
    monkeypatch.setattr(paths, "RESULTS", results)
    text = (paths.ROOT / "postproc" / "README.md").read_text()
    (study,) = re.findall(r"```toml\n(.*?)```", text, re.DOTALL)
    assert tomllib.loads(study)["engines"] == ["verlet"]
    Path("speeds.toml").write_text(study)
    done = beads("batch", "speeds.toml", "--runs", runs, "--results", results)
    assert done.returncode == 0, done.stderr
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(compile(block, "postproc/README.md", "exec"), names)
    pyplot().close("all")
    assert Path("gauges.png").stat().st_size > 1000
    assert names["power"] == pytest.approx(1 / 6, abs=0.005)
    assert isinstance(names["errors"], dict)
    assert names["errors"]["force"] <= 1e-4
    capsys.readouterr()
    (example,) = re.findall(r"^```python\n(.*?)^```", (paths.ROOT / "validation/README.md").read_text(), re.M | re.S)
    exec(example, {})
    (stated,) = re.findall(r"# ([\d.]+ N)$", example, re.MULTILINE)
    assert capsys.readouterr().out == f"{stated}\n"


def test_places_to_edit_exist() -> None:
    table = (paths.ROOT / "drivers/README.md").read_text().partition("| to change or add |")[2].partition("\n\n")[0]
    places = re.findall(r"`([\w/]+(?:/|\.py|\.toml))`", table)
    assert len(places) > 20
    for place in places:
        folders = (paths.ROOT, paths.ROOT / "drivers", paths.INPUTS, *(paths.ROOT / "validation").iterdir())
        assert any((folder / place).exists() for folder in folders), place
