"""The README of the checkout: short, its commands exist, its worked example runs line by line, its numbers hold."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from drivers.base import paths
from drivers.chain.schemes import verlet_in_heights
from postproc.read.residual import residual
from validation.accuracy.plan import planned_case
from validation.tests.helpers.readme import command_lines, parse
from validation.tests.helpers.runs import finished

README = paths.ROOT / "README.md"
TEXT = README.read_text()
MAX_LINES = 200
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
(SCENE,) = (block for language, block in BLOCKS if language == "toml")
EXAMPLES = [block for _, block in BLOCKS if "steel.toml" in block]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the environment and the scene of the example."""
    (tmp_path / ".venv").symlink_to(sys.prefix)
    (tmp_path / "steel.toml").write_text(SCENE)
    return tmp_path


def typed(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Types a line into a shell that has entered the environment."""
    return subprocess.run(
        ["bash", "-c", f". .venv/bin/activate\n{line}"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
        env=os.environ | {"MPLBACKEND": "Agg"},
    )


def test_it_is_short() -> None:
    assert len(TEXT.splitlines()) <= MAX_LINES


@pytest.mark.parametrize("line", command_lines(README))
def test_commands_parse(line: str) -> None:
    parse(line)


def test_links_and_targets_exist() -> None:
    for link in re.findall(r"\]\(([^)#]+)", TEXT):
        assert (paths.ROOT / link).exists(), link
    known = " ".join(re.findall(r"^\.PHONY: (.*)$", (paths.ROOT / "Makefile").read_text(), re.MULTILINE)).split()
    figures = [path.stem for path in (paths.ROOT / "postproc" / "figures").glob("[a-z]*.py")]
    measured = ["claims", "trade", "stability", "elements", "independent", "calibration"]
    assert set(re.findall(r"(?:^|`)make ([\w-]+)", TEXT, re.MULTILINE)) <= {*known, *figures, *measured}


def test_links_into_other_readmes_lead_to_a_heading() -> None:
    for link, anchor in re.findall(r"\]\(([^)#]+)#([^)]+)\)", TEXT):
        headings = re.findall(r"^#+ (.*)$", (paths.ROOT / link).read_text(), re.MULTILINE)
        assert anchor in [re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings], anchor


def test_the_example_runs_line_by_line(folder: Path) -> None:
    """Each line of the worked example ends well, in the runs folder of the checkout, as a reader types it."""
    lines = [line for block in EXAMPLES for line in block.splitlines()]
    assert len(lines) > 6
    printed = {}
    for line in lines:
        ended = typed(line, folder)
        assert ended.returncode == 0, f"{line}\n{ended.stdout}\n{ended.stderr}"
        printed[line.partition(" #")[0].strip()] = ended.stdout
    for picture in re.findall(r"results/[\w-]+\.svg", "".join(EXAMPLES)):
        assert (paths.ROOT / picture).exists(), picture
    assert "speed_7_to_3_m_s" in printed["beads observables yade:steel"]
    assert "FAIL" not in printed["beads compare steel.toml"]
    assert "Ten steel beads" in (folder / "steel.html").read_text()


def test_the_example_of_a_mistake(folder: Path) -> None:
    (stated,) = re.findall(r"`(steel.toml: [^`]+)`", TEXT)
    (folder / "steel.toml").write_text(SCENE.replace("\nspeed", "\nsped"))
    ended = typed("beads plan steel.toml", folder)
    assert ended.returncode == 2
    assert ended.stderr == f"{stated}\n"


@pytest.mark.parametrize("engine", ["liggghts", "yade", "lammps"])
def test_deviation_from_the_baseline(engine: str, shared_runs: Path) -> None:
    assert "differ by less than 1e-11 of the largest change" in TEXT
    case = planned_case("fig4")
    assert residual(finished(case, engine, shared_runs).trace, verlet_in_heights(case)).max() < 1e-11
