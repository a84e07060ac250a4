"""Help texts of the three command lines and of ``make help``: short, complete, with examples that are true."""

import argparse
import re
import shlex
import subprocess
from collections.abc import Iterator
from importlib import import_module

import pytest

from drivers.base.command_line import Parser
from drivers.base.paths import ROOT
from validation.tests.helpers.commands import command_line

PROGRAMS = ("drivers", "postproc", "validation")
WIDTH = 80


def commands(program: str) -> dict[str, Parser]:
    """Parsers of the commands of a program, by name; the empty name for the program itself."""
    parser: Parser = import_module(f"{program}.__main__")._parser()
    return {"": parser, **parser.commands}


EACH = [pytest.param(program, name, id=f"{program} {name}") for program in PROGRAMS for name in commands(program)]


@pytest.mark.parametrize(("program", "name"), EACH)
def test_help_fits_the_terminal(program: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    parser = commands(program)[name]
    assert max(map(len, parser.format_help().splitlines())) <= WIDTH
    assert re.fullmatch(r"[A-Z][^\n]*\.(\nHelp on a command: .*)?", parser.description or "")
    for action in parser._actions:
        assert action.help or isinstance(action, argparse._SubParsersAction), action.dest
        if action.nargs != 0 and not isinstance(action, argparse._SubParsersAction):
            assert re.fullmatch(r"[A-Z](\S*)", str(action.metavar)), f"{action.dest}: {action.metavar}"


def examples() -> Iterator[tuple[str, str]]:
    """Example command lines with their program."""
    for program in PROGRAMS:
        for parser in commands(program).values():
            title, *lines = (parser.epilog or "").splitlines()
            assert title in ("example:", "examples:")
            assert lines
            yield from ((program, line.strip()) for line in lines)


@pytest.mark.parametrize(("program", "line"), [pytest.param(*each, id=each[1]) for each in examples()])
def test_examples_are_valid_command_lines(program: str, line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    python, option, module, *words = shlex.split(line)
    assert [python, option, module] == ["python", "-m", program]
    monkeypatch.setenv("BEAD_CHAINS_ENGINES", "")  # restored after --engines has set it
    assert commands(program)[""].parse_args(words).command == words[0]


@pytest.mark.parametrize("program", PROGRAMS)
def test_without_a_command_the_commands_are_listed(program: str) -> None:
    ended = command_line(program)
    assert ended.returncode == 2
    for name in commands(program):
        assert re.search(rf"^    {name}( |$)", ended.stdout, re.MULTILINE) or not name


def test_make_help_lists_every_target_in_aligned_columns() -> None:
    make = ["make", "--no-print-directory", "help"]  # "make test" hands its print of the directory on
    lines = subprocess.run(make, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    makefile = (ROOT / "Makefile").read_text()
    names = re.findall(r"^([a-z][a-z0-9-]*)(?=[ a-z0-9-]*:)", makefile, re.MULTILINE)
    listed = {line.split()[1] for line in lines}
    assert {*names, *(path.stem for path in (ROOT / "postproc" / "figures").glob("[a-z]*.py"))} == listed
    assert max(map(len, lines)) <= WIDTH
    assert len({len("".join(re.findall(r"^  make \S+ +", line))) for line in lines}) == 1


WITHOUT_REQUIRED_ARGUMENTS = [
    (program, name)
    for program in PROGRAMS
    for name, parser in commands(program).items()
    if name and not any(action.required for action in parser._actions)
]


@pytest.mark.parametrize(("program", "name"), WITHOUT_REQUIRED_ARGUMENTS)
def test_an_unknown_option_points_to_the_help_of_its_command(
    program: str, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    parsers = commands(program)
    with pytest.raises(SystemExit, match="2"):
        parsers[""].parse_args([name, "--unknown"])
    assert f"{parsers[name].prog} --help" in capsys.readouterr().err
