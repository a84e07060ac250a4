"""Commands on studies: ``batch``, ``study``, ``status``, ``show``."""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from drivers.base.errors import InputError
from validation.commands import options
from validation.commands.options import at_least_one, command, print_paths

if TYPE_CHECKING:
    from drivers.batch.study_cases import Request


def _slice(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"([0-9]{1,8})/([0-9]{1,8})", text)
    if found and 1 <= int(found[1]) <= int(found[2]):
        return int(found[1]), int(found[2])
    raise click.BadParameter(f"found {text}; allowed: I/N with I from 1 to N")


def request_of(
    study: str | Path, runs: Path, engines: Sequence[str] = (), patterns: Sequence[str] = (), *, retry: bool = False
) -> "Request":
    """Request for a study, with the functions of higher packages that a batch calls."""
    from drivers.batch.study_cases import Request
    from drivers.engines._entries import entry_files
    from postproc.read.observables import not_shown, observe
    from postproc.read.residual import residual
    from validation.accuracy.plan import plan_case

    functions, chosen = (plan_case, observe, residual), (tuple(engines), tuple(patterns))
    files = entry_files()
    return Request(study, runs.absolute(), *functions, *chosen, retry=retry, entries=files, not_shown=not_shown)


@command("sensitivity", "wall-material --engine verlet --workers 2 --dry-run", "sensitivity --slurm --wait")
@options.STUDY
@options.ENGINE
@options.ONLY
@options.RUNS
@options.RESULTS
@click.option(
    "--workers",
    metavar="N",
    type=at_least_one,
    help="Number of processes on this machine (default: number of cores).",
)
@options.DRY_RUN
@click.option("--retry", is_flag=True, help="Run failed cases again.")
@click.option("--yes", is_flag=True, help="Accept a study of more than 20,000 cases.")
@click.option("--slice", "part", metavar="I/N", type=_slice, help="Run part I of N here, without writing the table.")
@click.option(
    "--dask",
    metavar="ADDRESS",
    is_flag=False,
    flag_value="local",
    default="",
    help="Run on the Dask cluster at ADDRESS; without ADDRESS, on a local Dask cluster.",
)
@click.option("--slurm", is_flag=True, help="Run as a Slurm job array.")
@click.option(
    "--slices",
    metavar="N",
    type=at_least_one,
    help="Number of tasks of the job array (default: by the expected time).",
)
@click.option(
    "--slurm-line",
    "slurm_lines",
    metavar="LINE",
    multiple=True,
    help="Add a line to the job script, such as '#SBATCH --mem=2G'; repeatable.",
)
@click.option("--wait", is_flag=True, help="Wait for the job array, then write the table.")
def batch(
    study: str,
    engines: tuple[str, ...],
    patterns: tuple[str, ...],
    runs: Path,
    results: Path,
    workers: int | None,
    dry_run: bool,
    retry: bool,
    yes: bool,
    part: tuple[int, int] | None,
    dask: str,
    slurm: bool,
    slices: int | None,
    slurm_lines: tuple[str, ...],
    wait: bool,
) -> int:
    """Run the missing cases of a study and write its table."""
    places = [option for option, given in (("--slice", part), ("--dask", dask), ("--slurm", slurm)) if given]
    if len(places) > 1:
        raise InputError(places[1], "", f"not allowed with {places[0]}")
    for option, given in (("--wait", wait), ("--slices", slices), ("--slurm-line", slurm_lines)):
        if given and not slurm:
            raise InputError(option, "", "needs --slurm")
    if dry_run and part:
        raise InputError("--dry-run", "", "not allowed with --slice")
    if workers and (part or slurm):
        raise InputError("--workers", "", f"not allowed with {places[0]}")
    from drivers.base.processes import cores
    from drivers.batch.study_commands import JobArray, run_part
    from drivers.batch.study_commands import batch as run_study
    from drivers.run.execute import Place

    request = replace(request_of(study, runs, engines, patterns, retry=retry), elsewhere=slurm)
    if part:
        return run_part(request, *part)
    place = Place(workers or cores(), processes=not dask, dask=dask)
    array = JobArray(wait, slices, slurm_lines) if slurm else None
    return run_study(request, results, place, array, dry_run=dry_run, yes=yes)


@command("sensitivity", "speed-amplitude --x bead_5_amplitude --y speed_9_to_5 --log")
@options.STUDY
@options.RESULTS
@click.option("--x", metavar="COLUMN", default="", help="Draw --y against this column of the table.")
@click.option("--y", metavar="COLUMN", default="", help="Column of numbers; a name may be without its unit.")
@click.option("--log", is_flag=True, help="Make the axes of --x and --y logarithmic.")
@click.option("--power-law", is_flag=True, help="Fit y = C x^n to each curve of each engine.")
def study(study: str, results: Path, x: str, y: str, log: bool, power_law: bool) -> None:
    """Draw the table of a finished study, or two of its columns."""
    given = {"--x": x, "--y": y, "--log": log, "--power-law": power_law}
    missing = [option for option in ("--x", "--y") if not given[option]]
    if missing and any(given.values()):
        raise InputError(next(filter(given.get, given)), "", f"needs {' and '.join(missing)}")
    from drivers.batch.study import column_name, read_study
    from drivers.batch.study_table import read_study_table
    from postproc.draw.product import write_product
    from postproc.draw.study_figure import column_of, draw_study, draw_tornado
    from postproc.read.labels import key_label

    found, table = read_study(study), read_study_table(study, results)
    columns = {name: column_name(name, key) for name, key in found.columns.items()}
    labels = {columns[name]: key_label(name, key) for name, key in found.columns.items()}
    name, title = f"{found.name}-figure", found.file.title or found.name
    if x:
        x = column_of(table, x, "--x", columns, numbers=log or power_law)
        y = column_of(table, y, "--y", columns, numbers=True)
        name, how = f"{found.name}-{y}-{x}-xy", {"joined": not found.one_by_one, "log": log, "fitted": power_law}
        product = draw_study(table, title, (y,), f"--x {x} --y {y}", labels, x, **how)
    else:
        draw = draw_tornado if found.one_by_one else draw_study
        product = draw(table, title, found.file.figure, found.where, labels)
    print_paths(write_product(product, name, results))
    for line in product.notes:
        print(line)


@command("sensitivity --list")
@options.STUDY
@options.ENGINE
@options.ONLY
@options.RUNS
@click.option(
    "--list",
    "every",
    is_flag=True,
    help="Print the state of each case: done, failed, timeout, stale, claimed, to do, not installed.",
)
def status(study: str, engines: tuple[str, ...], patterns: tuple[str, ...], runs: Path, every: bool) -> int:
    """Count the rows of a study by state."""
    from drivers.batch.study_commands import status as print_status

    return print_status(request_of(study, runs, engines, patterns), every=every)


@command("wall-material 3 --engine lammps")
@options.STUDY
@click.argument("case", metavar="CASE", type=at_least_one, help="Number of the case, as in the table of the study.")
@options.ENGINE
@options.RUNS
def show(study: str, case: int, engines: tuple[str, ...], runs: Path) -> int:
    """Write one case of a study as run folders with their decks."""
    from drivers.batch.study_commands import show as show_case
    from validation.accuracy.assess import assess

    return show_case(request_of(study, runs, engines), case, assess)
