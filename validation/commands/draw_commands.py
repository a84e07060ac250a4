"""Commands that draw scenes, runs and studies."""

import json
from collections.abc import Mapping, Sequence
from math import inf
from pathlib import Path

from drivers.base.errors import InputError
from drivers.base.terminal import print_paths, text_table
from drivers.batch.rows import Batch
from drivers.batch.study import column_name
from drivers.batch.tables import read_study_table
from postproc.draw import drawings
from postproc.draw.energies import draw_energies, range_numbers, run_energies, write_energies
from postproc.draw.plot import Product, draw_spacetime, write_product, write_table
from postproc.draw.study_figure import draw_study, draw_tornado, key_label
from postproc.draw.vtk import FRAMES, write_series
from postproc.linear.modes import MAX_BEADS, modes_product
from postproc.linear.spectra import analyse, signals_of, spectrum_product
from postproc.read.motion import case_of_run, trace_with_state
from postproc.read.observables import without_unit
from postproc.read.run_tables import write_table as write_run_table
from validation.accuracy.plan import planned_case
from validation.commands.run_commands import open_shown


def draw(scene: str, settings: tuple[str, ...], results: Path) -> None:
    """Draw a scene to scale.

    Examples:
      beads draw fig4
      beads draw fig4 --set chain.count=5 --results drawings
    """
    case = planned_case(scene, *settings)
    product = Product(*drawings.draw_scene(case.scene, case.chain))
    print_paths(write_product(product, f"scene-{case.scene.name}", results))


def modes(scene: str, settings: tuple[str, ...], results: Path) -> None:
    """Draw linear modes of a scene, print bands and sound speed.

    Examples:
      beads modes steel-chain --set chain.precompression='10 N'
      beads modes dimer
    """
    case = planned_case(scene, *settings)
    beads = case.chain.beads
    if not 0 < beads <= MAX_BEADS:
        raise InputError(case.scene.file, "chain.count", f"{beads}", f"from 1 to {MAX_BEADS} beads for modes")
    try:
        product, bands = modes_product(case)
    except ValueError as error:
        print(f"{case.scene.name}: {error}")
    else:
        _write(product, f"modes-{case.scene.name}", results)
        print_paths([] if bands is None else [write_table(bands, f"modes-{case.scene.name}-bands", results)])


def spacetime(run: str, runs_read: Path, results: Path) -> None:
    """Draw the force in every contact of a run against time.

    Example:
      beads spacetime yade:fig4
    """
    opened, name, title = open_shown("spacetime", run, runs_read)
    print_paths(write_product(draw_spacetime({title: opened.trace}, width_in=6.4), name, results))


def spectrum(
    run: str, source: str, target: str, *, frequency: float | None = None, since: float = 0.0, until: float = inf,
    window: str, as_json: bool, runs_read: Path, results: Path,
) -> None:  # fmt: skip
    """Draw spectra and a transfer function of the gauges of a run.

    Examples:
      beads spectrum yade:driven-steel
      beads spectrum yade:driven-steel --from bead_15 --to wall --since '0.2 ms'
    """
    opened, name, title = open_shown("spectrum", run, runs_read)
    case, trace = case_of_run(opened), opened.trace
    signals = signals_of(case, trace)
    for option, word in (("--from", source), ("--to", target)):
        if word and word not in signals:
            raise InputError("beads spectrum", option, f'"{word}"', ", ".join(signals))
    if not signals:
        allowed = "a scene with chain.sensors, or a wall"
        raise InputError("beads spectrum", "RUN", "a run without gauges and drive", allowed)
    try:
        analysis = analyse(case, trace, (source, target), window, frequency, (since, until))
    except ValueError as error:
        raise InputError("beads spectrum", run, str(error), "a longer record or finer samples") from error
    if as_json:
        print(json.dumps(analysis.numbers, indent=2))
    else:
        _write(spectrum_product(case, analysis, title), name, results)


def energy(run: str, ranges: tuple[tuple[int, int], ...], runs_read: Path, results: Path) -> None:
    """Draw the energy of each bead (needs recorded positions).

    Examples:
      beads energy verlet:fig4
      beads energy verlet:fig4 --beads 1-5 --beads 6-21
    """
    opened, name, title = open_shown("energy", run, runs_read)
    energies = run_energies(opened)
    numbers = {f"{low}-{high}": range_numbers(energies, low, high) for low, high in ranges}
    sums = energies.sums_J
    if (work_J := opened.trace.drive_work_J) is not None:
        sums["work of the drive, negative"] = 0 - work_J
    sums["sum"] = sum(sums.values(), start=0 * energies.time_s)
    rows = [(part, f"{values[0]:.6g}", f"{values[-1]:.6g}") for part, values in sums.items()]
    print(*text_table([("energy (J)", "at time 0", "at the end"), *rows]), sep="\n")
    lines = [(bodies, *(f"{value:.6g}" for value in of_range.values())) for bodies, of_range in numbers.items()]
    if numbers:
        print(*text_table([("bodies", *next(iter(numbers.values()))), *lines]), sep="\n")
    table = results / f"{name}.parquet"
    written = write_product(draw_energies(energies, ranges, title), name, results)
    write_energies(energies, table, opened.record.about)
    print_paths([*written, table])


def film(run: str, *, frames: int = drawings.FRAMES, sideways: float = 1.0, runs_read: Path, results: Path) -> None:
    """Draw the chain of a run at several times, and an animated GIF.

    Example:
      beads film yade:fig4-tube --sideways 10
    """
    opened, name, title = open_shown("film", run, runs_read)
    motion = case_of_run(opened), trace_with_state(opened)
    _write(drawings.sheet(drawings.Film(*motion, frames, sideways), title), name, results)
    moving = drawings.Film(*motion, drawings.GIF_FRAMES, sideways)
    print_paths([drawings.write_animation(moving, title, results / f"{name}.gif")])


def vtk(run: str, *, frames: int = FRAMES, runs_read: Path, results: Path) -> None:
    """Write a run for ParaView (needs recorded positions).

    Example:
      beads vtk yade:fig4 --frames 200
    """
    opened, name, _ = open_shown("vtk", run, runs_read)
    print_paths(write_series(opened, results / name, frames))


def table(run: str, long: bool, *, out: Path | None = None, runs_read: Path, results: Path) -> None:
    """Write contact forces and energies of a run as a table.

    The ending of the file, .parquet or .csv, decides on the format.

    Examples:
      beads table yade:fig4
      beads table yade:fig4 --long --out forces.csv
    """
    opened, name, _ = open_shown("table", run, runs_read)
    file = out or results / f"{name}.parquet"
    file.parent.mkdir(parents=True, exist_ok=True)
    print_paths([write_run_table(opened, file, long=long)])


def study(study: str, runs: Path, results: Path, x: str, y: str, log: bool, power_law: bool) -> None:
    """Draw the rows of a study, or two columns of its table.

    Examples:
      beads study sensitivity
      beads study speed-amplitude --x bead_5_amplitude --y speed_9_to_5 --log
    """
    swept, table = Batch(study, runs).study, read_study_table(study, runs)
    columns = {name: column_name(name, key) for name, key in swept.columns.items()}
    labels = {columns[name]: key_label(name, key) for name, key in swept.columns.items()}
    name, title, grid = f"{swept.name}-figure", swept.file.title or swept.name, swept.file.combine == "grid"
    if x:
        numbers = [*map(str, table.select_dtypes("number"))]
        x = _column(x, "--x", numbers if log or power_law else [*numbers, *columns.values()], columns)
        y = _column(y, "--y", numbers, columns)
        name, how = f"{swept.name}-{y}-{x}-xy", {"joined": grid, "log": log, "fitted": power_law}
        product = draw_study(table, title, (y,), f"--x {x} --y {y}", labels, x, **how)
    else:
        product = (draw_study if grid else draw_tornado)(table, title, swept.file.figure, swept.where, labels)
    _write(product, name, results)


def _write(product: Product, name: str, results: Path) -> None:
    """Print what a product notes, and the paths of its files."""
    print(*(f"{note}\n" for note in product.notes), sep="", end="")
    print_paths(write_product(product, name, results))


def _column(given: str, option: str, allowed: Sequence[str], columns: Mapping[str, str]) -> str:
    """Column of a table by its name with or without the unit; ``columns`` has those of varied keys by such names."""
    found = ({without_unit(name): name for name in allowed} | {**columns}).get(given, given)
    if found not in allowed:
        raise InputError(option, "", f'"{given}"', f"columns: {', '.join(dict.fromkeys(allowed))}")
    return found
