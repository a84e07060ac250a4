"""Tests of what all commands share: help, messages of wrong words, version, environment, shell completion."""

import ast
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from click.shell_completion import BashComplete

from drivers.base import paths, processes
from drivers.base.processes import git
from drivers.engines import engine_names
from validation.commands.beads import BEADS as COMMANDS
from validation.tests.helpers.commands import BEADS, beads
from validation.tests.helpers.readme import parse

WIDTH = 80
EXAMPLE = re.compile(r"^    (beads .*)$", re.MULTILINE)
BARE_PYTHON = (sys.executable, "-S")  # a Python without the packages of the environment


def test_the_version_is_one_line() -> None:
    ended = beads("--version")
    assert ended.returncode == 0
    found = re.fullmatch(r"bead-chains (\S+), commit (\w+)( and changes)?, Python (\S+)\n", ended.stdout)
    assert found
    assert f'version = "{found[1]}"' in (paths.ROOT / "pyproject.toml").read_text()
    assert (git("rev-parse", "HEAD") or "unknown").startswith(found[2])


def test_new_files_outside_the_packages_are_no_changes(monkeypatch: pytest.MonkeyPatch) -> None:
    for status, changed in (
        ("?? steel.toml\n?? inputs/scenes/mine.toml", False),
        ("?? drivers/engines/mine.py", True),
        ("M Makefile\n?? steel.toml", True),
    ):
        monkeypatch.setattr(processes, "git", lambda *_, status=status: status)
        assert processes.local_changes() is changed


def test_an_unknown_engine_says_where_own_engines_are_read() -> None:
    said = beads("run", "fig4", "--engine", "lammps-pip").stderr
    assert said.startswith('--engine: found "lammps-pip"; allowed: ')
    assert said.endswith(
        "; own engines are read from ./engines.toml, ~/.config/bead-chains/engines.toml and --engines FILE\n"
    )


def test_outside_the_environment_one_line_gives_the_command_that_enters_it(tmp_path: Path) -> None:
    for place in (tmp_path, paths.ROOT):
        words, variables = [*BARE_PYTHON, *BEADS[1:], "--help"], {"PYTHONPATH": str(paths.ROOT)}
        ended = subprocess.run(words, capture_output=True, text=True, check=False, cwd=place, env=variables)
        assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1)
        assert re.match(r"Python 3\.\d+ without click: ", ended.stderr)
        there = (paths.ROOT / ".venv" / "bin" / "activate").exists()
        how = f". {'' if place == paths.ROOT else f'{paths.ROOT}/'}.venv/bin/activate"
        assert ended.stderr.rstrip().endswith(how if there else "setup")


def test_an_older_python_reads_that_far() -> None:
    """Modules read before one of another environment is missing are valid Python 3.8."""
    before = ["drivers/__init__", "drivers/environment", "drivers/base/__init__", "drivers/base/paths"]
    for module in (*before, "validation/__init__", "validation/commands/beads"):
        tree = ast.parse((paths.ROOT / f"{module}.py").read_text(), feature_version=(3, 8))
    imports = [ast.unparse(node) for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    assert imports[0] == "import drivers.environment"


def test_the_installed_command_lists_scenes_studies_and_materials_in_any_folder(tmp_path: Path) -> None:
    """``make setup`` installs it next to Python."""
    command = Path(sys.executable).with_name("beads")
    lines = subprocess.check_output([command, "scenes"], text=True, cwd=tmp_path).splitlines()
    listed = {line.split()[0] for line in lines}
    assert {file.stem for home in (paths.SCENES, paths.STUDIES) for file in home.glob("*.toml")} < listed
    assert "  fig4" in {line[:6] for line in lines if "Fig. 4: 21 PTFE beads struck by a PTFE bead at 2 m/s" in line}
    assert any(line.startswith("  brass ") for line in lines)


def test_a_shell_completes_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own.toml").touch()
    completion = BashComplete(COMMANDS, {}, "beads", "_BEADS_COMPLETE")
    for words, start, names in (
        ([], "ru", {"run", "runs"}),
        (["render"], "fig6b", {"fig6b", "fig6b-tube"}),
        (["run"], "own", {"own"}),
        (["batch"], "sens", {"sensitivity"}),
        (["figures"], "table", {"table1"}),
        (["plan", "fig4", "--engine"], "", set(engine_names())),
    ):
        assert {item.value for item in completion.get_completions(words, start)} == names


def test_help_fits_the_terminal_lists_all_commands_and_has_valid_examples() -> None:
    without_words = beads()
    assert (without_words.returncode, without_words.stdout) == (2, beads("--help").stdout)
    assert {*COMMANDS.commands} <= {*re.findall(r"^  (\w+) {2,}\w", without_words.stdout, re.MULTILINE)}
    for words in ((), *((name,) for name in COMMANDS.commands)):
        shown, short = beads(*words, "--help"), beads(*words, "-h")
        assert (shown.returncode, shown.stderr) == (0, "")
        assert short.stdout == shown.stdout
        assert max(map(len, shown.stdout.splitlines())) <= WIDTH, words
        examples = EXAMPLE.findall(shown.stdout)
        assert examples, words
        for line in examples:
            assert not words or line.split()[1] == words[0]
            parse(line)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("rnu",), "beads: no such command 'rnu'. Did you mean 'run'?"),
        (("--unknown",), "beads: no such option '--unknown'"),
        (("run",), "beads run: missing argument 'SCENE'"),
        (("run", "fig4", "--time-limi"), "beads run: no such option '--time-limi'. Did you mean '--time-limit'?"),
        (("run", "fig4", "fig5"), "beads run: got unexpected extra argument (fig5)"),
        (("trade", "--budget", "-1"), "beads trade: invalid value for '--budget': -1.0 is not in the range x>0"),
        (("trade", "--budget", "nan"), "beads trade: invalid value for '--budget': nan is not a finite number"),
        (("trade", "--budget", "x"), "beads trade: invalid value for '--budget': 'x' is not a valid number"),
        (("show", "sensitivity", "x"), "beads show: invalid value for 'CASE': 'x' is not a valid whole number"),
    ],
)
def test_a_wrong_command_line_ends_in_one_line(words: tuple[str, ...], said: str) -> None:
    ended = beads(*words)
    assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1)
    program = "beads" if len(words) == 1 and words[0] != "run" else f"beads {words[0]}"
    assert ended.stderr == f"{said} (see {program} --help)\n"


IMPORTS = "import os, signal, time, drivers.environment; os.kill(os.getpid(), signal.SIGINT); time.sleep(20)"
MAIN = "import time; from validation.commands.beads import run_main; run_main(lambda: {work})"
DROPPED = "type('', (), {'__del__': lambda _: (_ for _ in ()).throw(KeyboardInterrupt)})() and time.sleep(20)"


@pytest.mark.parametrize(
    ("code", "words", "end"),
    [
        (IMPORTS, "", -signal.SIGINT),
        (MAIN.format(work=DROPPED), "interrupted\n", 130),
        (MAIN.format(work="bytearray(1 << 62)"), "error: out of memory\n", 1),
    ],
)
def test_an_interrupt_and_the_end_of_memory_are_at_most_a_line(code: str, words: str, end: int) -> None:
    """While modules are imported; where Python drops exceptions."""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (end, words)


def test_too_little_memory_for_the_libraries_is_refused_in_one_line() -> None:
    limit = "import resource, sys; resource.setrlimit(resource.RLIMIT_AS, (600_000_000,) * 2); sys.argv[1:] = {}; "
    for words, code in ((["--help"], 0), (["plan", "fig4"], 1)):
        run = f"{limit.format(words)}from validation.commands.beads import main; main()"
        ended = subprocess.run([sys.executable, "-c", run], capture_output=True, text=True, check=False)
        refusal = "error: the memory is limited to 600 MB (ulimit -v); 1500 MB are needed\n"
        assert (ended.returncode, ended.stderr) == (code, refusal * code)
