"""Commands on studies: ``batch``, ``study``, ``status``, ``show``."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from drivers.base.errors import InputError
from validation.commands import options
from validation.commands.options import at_least_one, command, option, print_paths

if TYPE_CHECKING:
    from drivers.batch.rows import Batch


def _slice(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"([0-9]{1,8})/([0-9]{1,8})", text)
    if match and 1 <= int(match[1]) <= int(match[2]):
        return int(match[1]), int(match[2])
    raise click.BadParameter(f"found {text}; allowed: I/N with I from 1 to N")


def batch_of(
    study: str | Path, runs: Path, engines: Sequence[str] = (), patterns: Sequence[str] = (), **more: Any
) -> "Batch":
    """Batch of a study; ``more`` are fields of ``Batch``."""
    from drivers.batch.rows import Batch
    from drivers.engines import entry_files

    return Batch(study, runs.absolute(), tuple(engines), tuple(patterns), entries=entry_files(), **more)


def functions() -> dict[str, Any]:
    """Functions of higher packages that a batch calls to run its rows."""
    from postproc.read.observables import observe
    from validation.accuracy.plan import plan_case

    return {"plan": plan_case, "observe": observe}


@command("sensitivity", "wall-material --engine verlet --workers 2 --dry-run", "sensitivity --slurm --wait")
@options.STUDY
@options.ENGINE
@options.ONLY
@options.RUNS
@options.RESULTS
@option("--workers", "N", "Number of processes on this machine (default: number of cores).", type=at_least_one)
@options.DRY_RUN
@option("--retry", "", "Run failed cases again.")
@option("--yes", "", "Accept a study of more than 20,000 cases.")
@option("--slice part", "I/N", "Run part I of N here, without writing the table.", type=_slice)
@option(
    "--dask",
    "ADDRESS",
    "Run on the Dask cluster at ADDRESS; without ADDRESS, on a local Dask cluster.",
    is_flag=False,
    flag_value="local",
    default="",
)
@option("--slurm", "", "Run as a Slurm job array.")
@option("--slices", "N", "Number of tasks of the job array (default: by the expected time).", type=at_least_one)
@option(
    "--slurm-line slurm_lines",
    "LINE",
    "Add a line to the job script, such as '#SBATCH --mem=2G'; repeatable.",
    multiple=True,
)
@option("--wait", "", "Wait for the job array, then write the table.")
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
    places = [name for name, given in (("--slice", part), ("--dask", dask), ("--slurm", slurm)) if given]
    if len(places) > 1:
        raise InputError(places[1], "", f"not allowed with {places[0]}")
    for name, given in (("--wait", wait), ("--slices", slices), ("--slurm-line", slurm_lines)):
        if given and not slurm:
            raise InputError(name, "", "needs --slurm")
    if dry_run and part:
        raise InputError("--dry-run", "", "not allowed with --slice")
    if workers and (part or slurm):
        raise InputError("--workers", "", f"not allowed with {places[0]}")
    from drivers.base.processes import cores
    from drivers.batch.study import column_name
    from drivers.run.execute import Place
    from postproc.read.observables import describe
    from validation.commands import batch_answers

    asked = batch_of(study, runs, engines, patterns, retry=retry, elsewhere=slurm, part=part or (1, 1), **functions())
    for name, key in asked.study.columns.items():
        known = describe(column_name(name, key))
        if known.kind and column_name(name, key).endswith(known.ending):
            where, found = asked.study.where, f'"{column_name(name, key)}", the name of an observable'
            raise InputError(where, "axis", found, "another name of the column")
    if part:
        return batch_answers.run_part(asked)
    place = Place(workers or cores(), processes=not dask, dask=dask)
    job: dict[str, Any] = {"slices": slices, "lines": slurm_lines, "wait": wait}
    return batch_answers.run_study(asked, results, place, dry_run=dry_run, yes=yes, **job)


@command("sensitivity", "speed-amplitude --x bead_5_amplitude --y speed_9_to_5 --log")
@options.STUDY
@options.RUNS
@options.RESULTS
@option("--x", "COLUMN", "Draw --y against this column of the table.", default="")
@option("--y", "COLUMN", "Column of numbers; a name may be without its unit.", default="")
@option("--log", "", "Make the axes of --x and --y logarithmic.")
@option("--power-law", "", "Fit y = C x^n to each curve of each engine.")
def study(study: str, runs: Path, results: Path, x: str, y: str, log: bool, power_law: bool) -> None:
    """Draw the rows of a study, or two columns of its table."""
    given = {"--x": x, "--y": y, "--log": log, "--power-law": power_law}
    missing = [name for name in ("--x", "--y") if not given[name]]
    if missing and any(given.values()):
        raise InputError(next(filter(given.get, given)), "", f"needs {' and '.join(missing)}")
    from drivers.batch.study import column_name, read_study
    from drivers.batch.tables import read_study_table
    from postproc.draw.product import write_product
    from postproc.draw.study_figure import column_of, draw_study, draw_tornado
    from postproc.read.labels import key_label

    swept, table = read_study(study), read_study_table(study, runs)
    columns = {name: column_name(name, key) for name, key in swept.columns.items()}
    labels = {columns[name]: key_label(name, key) for name, key in swept.columns.items()}
    name, title = f"{swept.name}-figure", swept.file.title or swept.name
    if x:
        x = column_of(table, x, "--x", columns, numbers=log or power_law)
        y = column_of(table, y, "--y", columns, numbers=True)
        name, how = (
            f"{swept.name}-{y}-{x}-xy",
            {"joined": swept.file.combine == "grid", "log": log, "fitted": power_law},
        )
        product = draw_study(table, title, (y,), f"--x {x} --y {y}", labels, x, **how)
    else:
        draw = draw_study if swept.file.combine == "grid" else draw_tornado
        product = draw(table, title, swept.file.figure, swept.where, labels)
    print_paths(write_product(product, name, results))
    for line in product.notes:
        print(line)


@command("sensitivity --list")
@options.STUDY
@options.ENGINE
@options.ONLY
@options.RUNS
@option(
    "--list every",
    "",
    "Print the state of each case: done, failed, timeout, refused, stale, claimed, to do, not installed.",
)
def status(study: str, engines: tuple[str, ...], patterns: tuple[str, ...], runs: Path, every: bool) -> int:
    """Count the rows of a study by state."""
    from validation.commands import batch_answers

    return batch_answers.status(batch_of(study, runs, engines, patterns), every=every)


@command("wall-material 3 --engine lammps")
@options.STUDY
@click.argument("case", metavar="CASE", type=at_least_one, help="Number of the case, as in the table of the study.")
@options.ENGINE
@options.RUNS
def show(study: str, case: int, engines: tuple[str, ...], runs: Path) -> int:
    """Write one case of a study as run folders with their decks."""
    from validation.commands import batch_answers

    return batch_answers.show(batch_of(study, runs, engines, **functions()), case)
