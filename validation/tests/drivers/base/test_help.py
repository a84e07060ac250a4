"""Help texts of ``beads`` and of ``make help``: short, complete, with examples that are true."""

import re
import subprocess
from collections import defaultdict

import click
import pytest

from drivers.base.paths import ROOT
from validation.commands.beads import BEADS
from validation.tests.helpers.commands import beads
from validation.tests.helpers.readme import parse

WIDTH = 80
EXAMPLE = re.compile(r"^    (beads .*)$", re.MULTILINE)


def test_help_fits_the_terminal_lists_all_commands_and_has_valid_examples() -> None:
    assert {*BEADS.commands} <= {*re.findall(r"^  (\w+) {2,}\w", beads("--help").stdout, re.MULTILINE)}
    for words in ((), *((name,) for name in BEADS.commands)):
        shown, short = beads(*words, "--help"), beads(*words, "-h")
        assert (shown.returncode, shown.stderr) == (0, "")
        assert short.stdout == shown.stdout
        assert max(map(len, shown.stdout.splitlines())) <= WIDTH, words
        examples = EXAMPLE.findall(shown.stdout)
        assert examples, words
        for line in examples:
            assert not words or line.split()[1] == words[0]
            parse(line)


def test_an_option_means_the_same_everywhere() -> None:
    """Except ``--out``: the folder of a deck, or the file of a page."""
    meanings = defaultdict(set)
    for command in BEADS.commands.values():
        for parameter in command.params:
            assert getattr(parameter, "help", ""), f"{command.name} {parameter.name}"
            assert getattr(parameter, "is_flag", False) or re.fullmatch(r"\[?[A-Z](\S*)", str(parameter.metavar))
            if isinstance(parameter, click.Option):
                meanings[parameter.opts[0]].add((parameter.help, parameter.metavar, parameter.multiple, parameter.name))
    assert {option for option, found in meanings.items() if len(found) > 1} == {"--out"}


def test_without_a_command_the_help_is_printed() -> None:
    ended = beads()
    assert (ended.returncode, ended.stdout) == (2, beads("--help").stdout)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("rnu",), "beads: no such command 'rnu'. Did you mean 'run'?"),
        (("--unknown",), "beads: no such option '--unknown'"),
        (("run",), "beads run: missing argument 'SCENE'"),
        (("run", "fig4", "--time-limi"), "beads run: no such option '--time-limi'. Did you mean '--time-limit'?"),
        (("run", "fig4", "fig5"), "beads run: got unexpected extra argument (fig5)"),
        (("run", "fig4", "--time-limit", "-1"), "beads run: --time-limit: found -1; allowed: seconds above zero"),
        (("show", "sensitivity", "x"), "beads show: CASE: found x; allowed: a whole number from 1"),
        (
            ("batch", "sensitivity", "--slice", "3/2"),
            "beads batch: --slice: found 3/2; allowed: I/N with I from 1 to N",
        ),
    ],
)
def test_a_wrong_command_line_ends_in_one_line(words: tuple[str, ...], said: str) -> None:
    ended = beads(*words)
    assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1)
    program = "beads" if len(words) == 1 and words[0] != "run" else f"beads {words[0]}"
    assert ended.stderr == f"{said} (see {program} --help)\n"


def test_a_plan_is_limited_to_engines() -> None:
    said = beads("plan", "two-spheres", "--engine", "verlet").stdout
    assert re.search(r"^engine +verlet, ", said, re.MULTILINE)
    assert "other engines" not in said
    assert re.search(r"^ +time step +error of force +verlet$", said, re.MULTILINE)
    refused = beads("plan", "fig4-tube", "--engine", "reference")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)


def test_make_help_lists_every_target() -> None:
    make = ["make", "--no-print-directory", "help"]  # "make test" hands its print of the directory on
    lines = subprocess.run(make, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    names = re.findall(r"^([a-z][a-z0-9-]*)(?=[ a-z0-9-]*:)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    figures = (path.stem for path in (ROOT / "postproc" / "figures").glob("[a-z]*.py"))
    assert {line.split()[1] for line in lines} == {*names, *figures}
    assert max(map(len, lines)) <= WIDTH
