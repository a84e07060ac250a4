"""Help texts of ``beads`` and of ``make help``: short, complete, with examples that are true."""

import re
import subprocess
from collections import defaultdict

import click
import pytest

from drivers.base.paths import ROOT
from validation.commands.beads import BEADS, SECTIONS
from validation.tests.helpers.commands import beads
from validation.tests.helpers.readme import parse

WIDTH = 80
FIRST_TO_LAST = (
    "scenes keys plan draw modes run compare observables spacetime spectrum energy film vtk overlay fit batch study "
    "status show runs render import report figures claims trade stability elements calibration engine wave"
)
EXAMPLE = re.compile(r"^    (beads .*)$", re.MULTILINE)


def test_commands_are_listed_in_the_order_in_which_a_user_meets_them() -> None:
    shown = beads("--help").stdout
    listed = re.findall(r"^  (\w+) {2,}\w", shown.partition(f"{next(iter(SECTIONS))}:")[2], re.MULTILINE)
    assert " ".join(listed) == FIRST_TO_LAST
    assert re.findall(r"^([a-z][a-z ]+):$", shown, re.MULTILINE) == [*SECTIONS]


@pytest.mark.parametrize("words", [(), *((name,) for name in FIRST_TO_LAST.split())], ids=lambda words: " ".join(words))
def test_help_fits_the_terminal_and_has_valid_examples(words: tuple[str, ...]) -> None:
    shown, short = beads(*words, "--help"), beads(*words, "-h")
    assert (shown.returncode, shown.stderr) == (0, "")
    assert short.stdout == shown.stdout
    assert max(map(len, shown.stdout.splitlines())) <= WIDTH
    examples = EXAMPLE.findall(shown.stdout)
    assert examples
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


def test_summaries_are_one_line() -> None:
    lines = beads("--help").stdout.splitlines()
    for name, command in BEADS.commands.items():
        assert f"  {name:11}  {command.get_short_help_str(WIDTH)}" in lines


def test_the_figures_are_listed_with_their_captions() -> None:
    from postproc.figures import captions

    shown = " ".join(beads("figures", "--help").stdout.split())
    for name, caption in captions().items():
        assert f"{name} {caption.title}" in shown


def test_without_a_command_the_help_is_printed() -> None:
    ended = beads()
    assert (ended.returncode, ended.stdout) == (2, beads("--help").stdout)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("wak",), "beads: no such command 'wak'"),
        (("rnu",), "beads: no such command 'rnu'. Did you mean 'run'?"),
        (("--unknown",), "beads: no such option '--unknown'"),
        (("run",), "beads run: missing argument 'SCENE'"),
        (("run", "fig4", "--time-limi"), "beads run: no such option '--time-limi'. Did you mean '--time-limit'?"),
        (("run", "fig4", "--engine"), "beads run: option '--engine' requires an argument"),
        (("run", "fig4", "fig5"), "beads run: got unexpected extra argument (fig5)"),
        (("run", "fig4", "--time-limit", "-1"), "beads run: --time-limit: found -1; allowed: seconds above zero"),
        (("show", "sensitivity", "x"), "beads show: CASE: found x; allowed: a whole number from 1"),
        (
            ("batch", "sensitivity", "--slice", "3/2"),
            "beads batch: --slice: found 3/2; allowed: I/N with I from 1 to N",
        ),
        (("render", "fig4"), "beads render: missing option '--out'"),
    ],
)
def test_a_wrong_command_line_ends_in_one_line(words: tuple[str, ...], said: str) -> None:
    ended = beads(*words)
    assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1)
    program = "beads" if len(words) == 1 and words[0] != "run" else f"beads {words[0]}"
    assert ended.stderr == f"{said} (see {program} --help)\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--slice", "1/2", "--slurm"), "--slurm: not allowed with --slice"),
        (("--dask", "--slurm"), "--slurm: not allowed with --dask"),
        (("--wait",), "--wait: needs --slurm"),
        (("--slice", "1/2", "--workers", "2"), "--workers: not allowed with --slice"),
    ],
)
def test_options_of_a_batch_that_exclude_each_other(words: tuple[str, ...], said: str) -> None:
    ended = beads("batch", "sensitivity", *words)
    assert (ended.returncode, ended.stdout, ended.stderr) == (2, "", f"{said}\n")


def test_an_unknown_figure_is_refused_with_the_known_ones() -> None:
    ended = beads("figures", "fig9")
    assert (ended.returncode, ended.stderr[:36]) == (2, 'figures: found "fig9"; allowed: fig1')


def test_a_plan_is_limited_to_engines() -> None:
    said = beads("plan", "two-spheres", "--engine", "verlet").stdout
    assert re.search(r"^engine +verlet, ", said, re.MULTILINE)
    assert "other engines" not in said
    assert re.search(r"^ +time step +error of force +verlet$", said, re.MULTILINE)
    refused = beads("plan", "fig4-tube", "--engine", "reference")
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)


def test_make_help_lists_every_target_in_aligned_columns() -> None:
    make = ["make", "--no-print-directory", "help"]  # "make test" hands its print of the directory on
    lines = subprocess.run(make, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    makefile = (ROOT / "Makefile").read_text()
    names = re.findall(r"^([a-z][a-z0-9-]*)(?=[ a-z0-9-]*:)", makefile, re.MULTILINE)
    listed = {line.split()[1] for line in lines}
    assert {*names, *(path.stem for path in (ROOT / "postproc" / "figures").glob("[a-z]*.py"))} == listed
    assert max(map(len, lines)) <= WIDTH
    assert len({len("".join(re.findall(r"^  make \S+ +", line))) for line in lines}) == 1
