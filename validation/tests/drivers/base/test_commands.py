"""Tests of options shared by all commands: version, missing environment, shell completion, lists of inputs."""

import ast
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from drivers import environment
from drivers.base import paths, processes
from drivers.base.processes import git
from drivers.engines import VERLET, engine_names
from validation.tests.helpers.commands import BEADS, beads

BARE_PYTHON = (sys.executable, "-S")  # a Python without the packages of the environment


def test_the_version_is_one_line() -> None:
    ended = beads("--version")
    assert ended.returncode == 0
    found = re.fullmatch(r"bead-chains (\S+), commit (\w+)( and changes)?, Python (\S+)\n", ended.stdout)
    assert found
    assert f'version = "{found[1]}"' in (paths.ROOT / "pyproject.toml").read_text()
    assert (git("rev-parse", "HEAD") or "unknown").startswith(found[2])


@pytest.mark.parametrize(
    ("status", "changed"),
    [
        ("?? steel.toml\n?? inputs/scenes/mine.toml", False),
        ("?? drivers/engines/mine.py", True),
        ("M Makefile\n?? steel.toml", True),
    ],
)
def test_new_files_outside_the_packages_are_no_changes(
    status: str, changed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(processes, "git", lambda *_: status)
    assert processes.local_changes() is changed


def test_an_unknown_engine_says_where_own_engines_are_read(tmp_path: Path) -> None:
    said = beads("run", "fig4", "--engine", "lammps-pip").stderr
    assert said.startswith('--engine: found "lammps-pip"; allowed: ')
    for place in ("./engines.toml", "~/.config/bead-chains/engines.toml", "--engines FILE"):
        assert place in said


def test_outside_the_environment_one_line_gives_the_command_that_enters_it(tmp_path: Path) -> None:
    for place in (tmp_path, paths.ROOT):
        ended = subprocess.run(
            [*BARE_PYTHON, *BEADS[1:], "--help"],
            capture_output=True,
            text=True,
            check=False,
            cwd=place,
            env={"PYTHONPATH": str(paths.ROOT)},
        )
        assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1)
        assert ended.stderr.startswith("Python without click, filelock, jinja2, ...: ")
        there = (paths.ROOT / ".venv" / "bin" / "activate").exists()
        how = f". {'' if place == paths.ROOT else f'{paths.ROOT}/'}.venv/bin/activate"
        assert ended.stderr.rstrip().endswith(how if there else "setup")


def test_an_older_python_reads_that_far_and_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """Modules read before the environment is checked are valid Python 3.8 and import nothing newer."""
    command = "validation/commands/beads.py"
    before = ["drivers/__init__", "drivers/environment", "drivers/base/__init__", "drivers/base/paths"]
    for file in (*(f"{module}.py" for module in before), "validation/__init__.py", command):
        ast.parse((paths.ROOT / file).read_text(), feature_version=(3, 8))
    tree = ast.parse((paths.ROOT / command).read_text())
    imports = [ast.unparse(node) for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    assert imports[0] == "import drivers.environment"
    assert environment.trouble() == ""
    monkeypatch.setattr(sys, "version_info", (3, 9, 2))
    assert environment.trouble().startswith("Python 3.9, and 3.11 or later is needed: ")


def test_the_installed_command_works_in_any_folder(tmp_path: Path) -> None:
    """``make setup`` installs it next to Python."""
    command = [str(Path(sys.executable).with_name("beads")), "draw", "fig4", "--results", "."]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "scene-fig4.svg").is_file()


def test_scenes_studies_and_materials_are_listed() -> None:
    lines = beads("scenes").stdout.splitlines()
    listed = {line.split()[0] for line in lines}
    assert {file.stem for home in (paths.SCENES, paths.STUDIES) for file in home.glob("*.toml")} < listed
    titled = dict(line.split(maxsplit=1) for line in lines if line.startswith("  "))
    assert titled["fig4"] == "Fig. 4: 21 PTFE beads struck by a PTFE bead at 2 m/s"
    assert any(line.startswith("  brass ") for line in lines)


def completed(line: str, place: Path) -> set[str]:
    """Completions that bash offers at the end of a line, whose words end at colons as well."""
    command = place / "beads"
    command.write_text(shlex.join(["#!/bin/sh\nexec", *BEADS]).replace("'", "") + ' "$@"\n')
    command.chmod(0o755)
    script = """
        eval "$(_BEADS_COMPLETE=bash_source beads)"
        compopt() { :; }
        read -ra COMP_WORDS <<< "${1//:/ : }"
        [[ $1 == *" " ]] && COMP_WORDS+=("")
        COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
        _beads_completion beads
        printf '%s\\n' "${COMPREPLY[@]}"
    """
    ended = subprocess.run(
        ["bash", "--norc", "-c", script, "bash", line],
        capture_output=True,
        text=True,
        check=True,
        cwd=place,
        env=os.environ | {"PATH": f"{place}:{os.environ['PATH']}", "PYTHONPATH": str(paths.ROOT)},
    )
    return set(ended.stdout.split())


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("beads ru", {"run", "runs"}),
        ("beads run own", {"own.toml"}),
        ("beads batch sens", {"sensitivity"}),
        ("beads film --runs there verlet:s", {"small", "small-other"}),
        ("beads compare --runs there verlet:small verlet:", {"small", "small-other"}),
        ("beads plan fig4 --engine ", set(engine_names())),
    ],
)
def test_a_shell_completes(line: str, words: set[str], tmp_path: Path) -> None:
    (tmp_path / "own.toml").touch()
    for name in ("small-0123ab-0123456789ab", "small-other-0123ab-0123456789ab", ".work"):
        (tmp_path / "there" / VERLET / name).mkdir(parents=True)
    assert completed(line, tmp_path) == words
