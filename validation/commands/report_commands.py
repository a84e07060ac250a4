"""Commands of the report and its chapters, and of the paper's figures."""

import shlex
import sys
from pathlib import Path
from typing import Any

import click

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from validation.commands import completion, options
from validation.commands.options import Decorator, checked, command, must_be_file, option, print_paths, seconds


@command("", "fig4 --out fig4.html --allow-missing")
@options.scenes_argument("the paper's four")
@option(
    "--studies",
    "",
    "Write the page first, then make figures and studies and add them; short studies where no table exists.",
)
@option("--out", "FILE", "Page to write (default: results/report.html).", type=Path, callback=checked(must_be_file))
@options.ENGINE
@options.RUNS
@options.REQUIRE
@options.ALLOW_MISSING
def report(
    scenes: tuple[str, ...],
    studies: bool,
    out: Path | None,
    engines: tuple[str, ...],
    runs: Path,
    required: tuple[str, ...],
    allow_missing: bool,
) -> int:
    """Write the report page and its checks as JSON."""
    from drivers.engines import engines_again
    from validation.compare.comparison import EngineSelection
    from validation.report.write_report import report as write

    arguments = sys.argv[1:] if "--engines" in sys.argv else [*sys.argv[1:], *engines_again()]
    asked = EngineSelection(engines, required, allow_missing)
    given = None if runs == paths.RUNS else runs
    return write(scenes, out, given, asked, shlex.join(["beads", *arguments]), studies=studies)


class _Figures(click.Command):
    """Command whose help lists the figures."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        from postproc.figures import captions

        with formatter.section("Figures"):
            formatter.write_dl([(name, caption.title) for name, caption in captions().items()])
        super().format_epilog(ctx, formatter)


@command("", "fig4 table1", kind=_Figures)
@click.argument(
    "names", metavar="[NAME]...", nargs=-1, help="Figures (default: all).", shell_complete=completion.figures
)
@options.RUNS
@options.RESULTS
def figures(names: tuple[str, ...], runs: Path, results: Path) -> int:
    """Make figures and the table of the paper."""
    from postproc.figures import captions

    titles, code = {name: caption.title for name, caption in captions().items()}, 0
    for name in names:
        if name not in titles:
            raise InputError("figures", "", f'"{name}"', ", ".join(titles))
    from drivers.base.terminal import counted
    from drivers.engines import missing_codes
    from validation.chapters import write_paper_figure

    chosen = list(dict.fromkeys(names)) or [*titles]
    for name in chosen:  # a failed figure does not stop the others
        try:
            with counted(f"{name}: {titles[name]}"):
                written = write_paper_figure(name, runs, results)
        except (RunError, InputError) as error:
            print(f"{name}: {error}", file=sys.stderr)
            code = max(code, 2 if isinstance(error, InputError) else 1)
            continue
        print_paths(written)
    if missing_codes():
        print(f"left out, since not installed: {', '.join(missing_codes())}", file=sys.stderr)
    return code


def _chapter(name: str, text: str, *taken: Decorator, examples: tuple[str, ...] = ("", "--quick")) -> click.Command:
    """Command of a chapter with its help text and options."""

    def action(**given: Any) -> int:
        from validation.chapters import Options, run_chapter

        return run_chapter(name, Options(**{key: value for key, value in given.items() if value is not None}))

    for add in reversed((*taken, options.RESULTS)):
        action = add(action)
    return command(*examples, name=name, text=text)(action)


BUDGET = option(
    "--budget budget_s",
    "SECONDS",
    "Engine time of all runs together (default: 300 s; 30 s with --quick).",
    type=seconds,
)
CASES_FILE = option(
    "--file", "FILE", "Judge the cases of a file alone (default: all claims and inputs/independent.toml).", type=Path
)
CHAPTER_COMMANDS = (
    _chapter(
        "claims", "Judge the paper's statements, and engines by published numbers.", CASES_FILE, options.RUNS,
        examples=("", "--file my-cases.toml"),
    ),
    _chapter(
        "trade", "Measure error against cost for all engines and time steps.", options.QUICK, BUDGET,
        examples=("--quick", "--budget 600"),
    ),
    _chapter("stability", "Measure stable steps, extreme scenes, long runs.", options.QUICK, options.RUNS),
    _chapter("elements", "Measure effect and cost of each modelling element.", options.QUICK, options.RUNS),
    _chapter("calibration", "Fit parameters of each contact law to the paper's experiments.", options.QUICK),
)  # fmt: skip
