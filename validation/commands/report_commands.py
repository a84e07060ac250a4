"""Commands of the report and its chapters, and of the paper's figures."""

import shlex
import sys
import traceback
from pathlib import Path
from runpy import run_path

from drivers.base import paths
from drivers.base.errors import InputError, RunError, one_line
from drivers.base.terminal import counted, print_paths
from drivers.engines import engines_again, missing_codes
from postproc.draw.plot import Product, write_product
from postproc.figures import caption_of, captions
from validation.chapters import CHAPTERS, Options, run_chapter, write_paper_figure
from validation.commands.run_commands import Words
from validation.compare.comparison import EngineSelection
from validation.report import write_report


def report(
    scenes: Words, studies: bool, *, out: Path | None = None, engines: Words, runs: Path, require: Words,
    allow_missing: bool,
) -> int:  # fmt: skip
    """Write the report page and its checks as JSON.

    Examples:
      beads report
      beads report fig4 --out fig4.html --allow-missing
    """
    again = shlex.join(["beads", *sys.argv[1:], *([] if "--engines" in sys.argv else engines_again())])
    selection = EngineSelection(engines, require, allow_missing)
    return write_report.report(scenes, out, None if runs == paths.RUNS else runs, selection, again, studies=studies)


def figures(names: Words, runs: Path, results: Path) -> int:
    """Make figures and the table of the paper, or of your own.

    Examples:
      beads figures
      beads figures fig4 table1
      beads figures my_figure.py
    """
    known, code = captions(), 0
    for name in names:
        if name not in known and not name.endswith(".py"):
            raise InputError("figures", "", f'"{name}"', f"{', '.join(known)}, or a Python file of your own")
    for name in dict.fromkeys(names or known):
        try:
            caption = known.get(name) or caption_of(Path(name))
            with counted(f"{name}: {caption.title}"):
                written = (write_paper_figure if name in known else _write_own)(name, runs, results)
        except (RunError, InputError) as error:
            print(f"{name}: {error}" if name in known else error, file=sys.stderr)
            code = max(code, 2 if isinstance(error, InputError) else 1)
        else:
            print_paths(written)
    if missing_codes():
        print(f"left out, since not installed: {', '.join(missing_codes())}", file=sys.stderr)
    return code


def _write_own(name: str, runs: Path, results: Path) -> list[Path]:
    """Execute a figure file and write its table, figure and spacetime diagram under its name.

    Raises:
        InputError: The file has no function that makes a product, or the name of another output.
        RunError: An exception in the file, with the line.
    """
    file, shown = Path(name).resolve(), paths.shown(Path(name))
    if file.stem in (*captions(), *CHAPTERS):
        raise InputError(shown, "", file.stem, "a name that is not that of a figure of the paper or of a chapter")
    try:
        make = run_path(str(file)).get("make")
        if not callable(make):
            raise InputError(shown, "make", "no such function", "make(runs), which returns a Product")
        product = make(runs)
        if not isinstance(product, Product):
            raise InputError(shown, "make", f"{type(product).__name__} returned", "a Product")
        return write_product(product, file.stem, results)
    except (InputError, RunError):
        raise
    except Exception as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(file)]
        place = f", line {lines[-1]}" if lines else ""
        raise RunError(one_line(f"{shown}{place}: {type(error).__name__}: ", error)) from error


def claims(*, file: Path = paths.INDEPENDENT, runs: Path, results: Path) -> int:
    """Judge the paper's statements, and engines by published numbers.

    Examples:
      beads claims
      beads claims --file my-cases.toml
    """
    return run_chapter("claims", Options(results, runs, file))


def trade(quick: bool, *, budget_s: float | None = None, results: Path) -> int:
    """Measure error against cost for all engines and time steps.

    Examples:
      beads trade --quick
      beads trade --budget 600
    """
    return run_chapter("trade", Options(results, quick=quick, budget_s=budget_s))


def stability(quick: bool, runs: Path, results: Path) -> int:
    """Measure stable steps, extreme scenes, long runs.

    Examples:
      beads stability
      beads stability --quick
    """
    return run_chapter("stability", Options(results, runs, quick=quick))


def elements(quick: bool, runs: Path, results: Path) -> int:
    """Measure effect and cost of each modelling element.

    Examples:
      beads elements
      beads elements --quick
    """
    return run_chapter("elements", Options(results, runs, quick=quick))


def calibration(quick: bool, results: Path) -> int:
    """Fit parameters of each contact law to the paper's experiments.

    Examples:
      beads calibration
      beads calibration --quick
    """
    return run_chapter("calibration", Options(results, quick=quick))
