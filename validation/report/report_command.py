"""``python -m validation report``: compares scenes, running what is not done, and writes the report."""

import shlex
import sys
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import InputError
from validation.compare.compared_scenes import run_and_compare
from validation.compare.verdict import FAIL, NOT_RUN, PASS
from validation.report.write_report import AGAIN, write_report

PAPER = ("fig4", "fig5", "fig6b", "fig6d")


def report(sources: list[str], out: Path | None, runs: Path | None) -> int:
    """Writes the page with JSON and JUnit XML beside it; the exit code is 1 where a verdict is a failure.

    Raises:
        InputError: a scene is wrong, a scene is named twice, or the page would take its own files' names.
    """
    page = out or paths.RESULTS / "report.html"
    if page.suffix in (".json", ".xml"):
        raise InputError(f"--out {page}", "", page.suffix, "another ending: JSON and XML are written beside the page")
    compared = []
    for source in sources or PAPER:
        print(f"{source} ...", file=sys.stderr, flush=True)
        compared.append(run_and_compare(source, runs=runs or paths.RUNS))
    names = [scene.case.scene.name for scene in compared]
    for name in names:
        if names.count(name) > 1:
            raise InputError("report", "", f"two scenes named {name}", "scenes of different names")
    counts = write_report(compared, page, _command(sources, out, runs), runs)
    print(f"{paths.shown(page)}: {counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run")
    return 1 if counts[FAIL] else 0


def _command(sources: list[str], out: Path | None, runs: Path | None) -> str:
    """The command that makes the same page again."""
    if not sources and out is None and runs is None:
        return AGAIN
    options = [("--out", out), ("--runs", runs)]
    words = [*sources, *(word for name, value in options if value is not None for word in (name, str(value)))]
    return shlex.join(["python", "-m", "validation", "report", *words])
