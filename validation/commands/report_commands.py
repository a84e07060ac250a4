"""Commands of the report and its chapters, of the paper's figures, and of fits."""

import shlex
import sys
from pathlib import Path
from typing import Any

import click

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.terminal import counted
from drivers.engines import engines_again, missing_codes
from postproc.figures import captions
from validation.chapters import Options, run_chapter, write_paper_figure
from validation.commands.options import print_paths
from validation.compare.comparison import EngineSelection


def report(scenes: tuple[str, ...], studies: bool, out: Path | None, runs: Path, **engines: Any) -> int:
    """Write the page of scenes; it names the command line that makes it again."""
    from validation.report.write_report import report as write  # takes longer to load than all others

    arguments = sys.argv[1:] if "--engines" in sys.argv else [*sys.argv[1:], *engines_again()]
    given = None if runs == paths.RUNS else runs
    again = shlex.join(["beads", *arguments])
    return write(scenes, out, given, EngineSelection(**engines), again, studies=studies)


def figures(names: tuple[str, ...], runs: Path, results: Path) -> int:
    """Make the paper's figures; a failed one does not stop the others."""
    titles, code = {name: caption.title for name, caption in captions().items()}, 0
    for name in names:
        if name not in titles:
            raise InputError("figures", "", f'"{name}"', ", ".join(titles))
    for name in dict.fromkeys(names or titles):
        try:
            with counted(f"{name}: {titles[name]}"):
                written = write_paper_figure(name, runs, results)
        except (RunError, InputError) as error:
            print(f"{name}: {error}", file=sys.stderr)
            code = max(code, 2 if isinstance(error, InputError) else 1)
        else:
            print_paths(written)
    if missing_codes():
        print(f"left out, since not installed: {', '.join(missing_codes())}", file=sys.stderr)
    return code


def chapter(**given: Any) -> int:
    """Run the chapter after which the command is named."""
    name = str(click.get_current_context().command.name)
    return run_chapter(name, Options(**{key: value for key, value in given.items() if value is not None}))


def fit(results: Path, runs: Path, **asked: Any) -> int:
    """Fit parameters of scenes."""
    from validation.calibration.command import FitRequest, run_fit  # takes longer to load than all others

    return run_fit(FitRequest(**asked), runs, results)
