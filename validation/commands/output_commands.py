"""Commands that read or draw one run: ``observables``, ``overlay``, ``spacetime``, ``spectrum``, ``energy`` ..."""

import json
import sys
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING

import click

from drivers.base.errors import InputError
from drivers.base.terminal import text_table
from validation.commands import completion, options
from validation.commands.options import command, must_be_folder, number, option, print_paths

if TYPE_CHECKING:
    from drivers.run.run_folder import EndedRun


@command("yade:fig4", "yade:fig4 --level 0.1 --json")
@options.RUN
@options.RUNS_READ
@option(
    "--level levels",
    "X",
    "Measure widths at this share of the peak; repeatable (default: 0.002 and 0.04).",
    multiple=True,
    type=number(float, lambda share: 0 < share < 1, "a share of the peak, above 0 and below 1"),
)
@option("--json as_json", "", "Print JSON.")
@option(
    "--definitions",
    "",
    "Print the definitions of all observables and exit.",
    is_eager=True,
    expose_value=False,
    callback=lambda context, _, asked: _print_definitions(context) if asked else None,
)
def observables(run: str, runs: Path, levels: tuple[float, ...], as_json: bool) -> None:
    """Print peaks, speeds, widths, reflections, energies of a run."""
    from postproc.read.observables import LEVELS, observe, without_unit

    opened, _, _ = _open("observables", run, runs)
    observed = observe(opened.layout, opened.trace, levels or LEVELS)
    values = {name: None if isnan(value) else value for name, value in observed.items()}
    if as_json:
        print(json.dumps(values, indent=2))
        return
    errors = {part["quantity"]: f"{abs(part['whole']):.1e}" for part in opened.record.error_budget or ()}
    shown = {name: "not seen" if value is None else f"{value:.6g}" for name, value in values.items()}
    rows = [(name, value, errors.get(without_unit(name), "")) for name, value in shown.items()]
    print(*text_table([("observable", "value", "relative error"), *rows]), sep="\n")


def _print_definitions(context: click.Context) -> None:
    from postproc.read.observables import DEFINITIONS, SYMBOLS

    print(SYMBOLS, "", *text_table(DEFINITIONS.items()), sep="\n")
    context.exit()


@command("example-measured", "example-measured --set contact.restitution=0.9", "yade:fig4 --measured shot-12.csv")
@click.argument(
    "run",
    metavar="SCENE|RUN",
    help="A scene, for its exact motion; or a run folder, or ENGINE:SCENE.",
    shell_complete=completion.scenes_and_runs,
)
@options.SETTINGS
@options.MEASURED
@options.RUNS_READ
@options.RESULTS
def overlay(run: str, settings: tuple[str, ...], measured: Path | None, runs: Path, results: Path) -> None:
    """Draw measured traces over computed ones, with deviations."""
    from drivers.engines import REFERENCE
    from drivers.limits import refuse
    from drivers.run.inventory import scene_now
    from postproc.draw.overlay import HEADINGS, draw_overlay, misfit_rows
    from postproc.draw.product import write_product
    from postproc.paper.simulate import exact
    from postproc.read.measured import entries_of
    from postproc.read.misfit import lay_over
    from validation.accuracy.plan import planned_case

    if Path(run).is_dir() or (":" in run and not Path(run).exists()):
        if settings:
            raise InputError(f"--set {settings[0]}", "", "not allowed for a finished run")
        opened, name, _ = _open("overlay", run, runs)
        scene = scene_now(run.partition(":")[2]) or scene_now(opened.record.scene_name)  # names the measured data
        layout, trace, engine = opened.layout, opened.trace, opened.record.engine
    else:
        case = planned_case(run, *settings)
        refuse(case, REFERENCE)
        scene, layout, trace, engine = case.scene, case.layout, exact(case).trace, REFERENCE
        name = f"overlay-{scene.name}"
    entries, folder, where = entries_of(scene, measured, run)
    curves, misfits, remarks = lay_over(entries, folder, where, layout, trace)
    drawn = write_product(draw_overlay(layout, trace, engine, curves, misfits), name, results) if curves else ()
    print(*text_table([HEADINGS, *misfit_rows(misfits)]), sep="\n")
    for remark in remarks:
        print(remark, file=sys.stderr)
    print_paths(drawn)


@command("yade:fig4")
@options.RUN
@options.RUNS_READ
@options.RESULTS
def spacetime(run: str, runs: Path, results: Path) -> None:
    """Draw the force in every contact of a run against time."""
    from postproc.draw.product import draw_spacetime, write_product

    opened, name, title = _open("spacetime", run, runs)
    print_paths(write_product(draw_spacetime({title: opened.trace}, width_in=6.4), name, results))


@command("yade:driven-steel", "yade:driven-steel --from bead_15 --to wall --since '0.2 ms'")
@options.RUN
@option("--from source", "SIGNAL", "Source of the transfer function: drive, or a gauge.", default="")
@option("--to target", "SIGNAL", "Target of the transfer function: a gauge, such as wall.", default="")
@option("--frequency", "F", "Measure harmonics of this frequency (default: that of a sine drive).")
@option("--since", "TIME", "Begin of the record, such as '0.2 ms' (default: 0 s).", default="0 s")
@option("--until", "TIME", "End of the record (default: that of the run).")
@option("--window", "NAME", "hann (default), boxcar, blackmanharris or flattop.", default="hann")
@option("--json as_json", "", "Print JSON.")
@options.RUNS_READ
@options.RESULTS
def spectrum(
    run: str, source: str, target: str, frequency: str | None, since: str, until: str | None, window: str,
    as_json: bool, runs: Path, results: Path,
) -> None:  # fmt: skip
    """Draw spectra and a transfer function of the gauges of a run."""
    from drivers.chain.case import build_case
    from drivers.scene.read_scene import stored_scene
    from postproc.draw.product import write_product
    from postproc.linear.spectra import WINDOWS
    from postproc.linear.spectrum_figure import analyse, numbers_of, signals_of, spectrum_product

    opened, name, title = _open("spectrum", run, runs)
    case, trace = build_case(stored_scene(opened.record.scene)), opened.trace
    signals = signals_of(case, trace)
    for given, word, known in (("--from", source, signals), ("--to", target, signals), ("--window", window, WINDOWS)):
        if word and word not in known:
            raise InputError("beads spectrum", given, f'"{word}"', ", ".join(known))
    if not signals:
        raise InputError(
            "beads spectrum", "RUN", "a run without gauges and drive", "a scene with chain.sensors, or a wall"
        )
    from_s, to_s = _si("--since", since, "s"), _si("--until", until, "s") if until else float(trace.time_s[-1])
    hertz = _si("--frequency", frequency, "Hz") if frequency else None
    used = (trace.time_s >= from_s) & (trace.time_s <= to_s)
    try:
        parts = {gauge: values[used] for gauge, values in signals.items()}
        analysis = analyse(case, parts, trace.time_s[used], (source, target), window, hertz)
    except ValueError as error:
        raise InputError("beads spectrum", run, str(error), "a longer record or finer samples") from error
    if as_json:
        print(json.dumps(numbers_of(analysis), indent=2))
        return
    product = spectrum_product(case, analysis, title)
    print(*product.notes, sep="\n")
    print_paths(write_product(product, name, results))


def _si(option: str, text: str, unit: str) -> float:
    """Value of an option in an SI unit, zero or above."""
    from drivers.base.units import to_si

    try:
        value = to_si(text, unit)
    except ValueError as error:
        raise InputError("beads spectrum", option, f'"{text}"', f"a quantity in {unit}, such as 1 k{unit}") from error
    if value < 0 or (value == 0 and unit == "Hz"):
        raise InputError("beads spectrum", option, f'"{text}"', "zero or more" if unit == "s" else "above zero")
    return value


def _bodies(text: str) -> tuple[int, int]:
    """Reader of a range of bodies, such as 5-9, or one body."""
    low, dash, high = text.partition("-")
    ends = (low, high) if dash else (low, low)
    if not all(end.isascii() and end.isdigit() and len(end) < 9 for end in ends):
        raise click.BadParameter(f"found {text}; allowed: a body, such as 9, or a range of bodies, such as 5-9")
    return int(ends[0]), int(ends[1])


@command("verlet:fig4", "verlet:fig4 --beads 1-5 --beads 6-21")
@options.RUN
@option(
    "--beads ranges",
    "A-B",
    "Energy of the bodies A to B, counted from the wall, the striker last; repeatable.",
    multiple=True,
    type=_bodies,
)
@options.RUNS_READ
@options.RESULTS
def energy(run: str, ranges: tuple[tuple[int, int], ...], runs: Path, results: Path) -> None:
    """Draw the energy of each bead (needs recorded positions)."""
    from postproc.draw.product import write_product
    from postproc.energy.energies import range_numbers, run_energies
    from postproc.energy.energy_figure import draw_energies, write_energies

    opened, name, title = _open("energy", run, runs)
    energies = run_energies(opened)
    numbers = {f"{low}-{high}": range_numbers(energies, low, high) for low, high in ranges}
    sums = energies.sums_J
    if opened.trace.drive_work_J is not None:
        sums["work of the drive, negative"] = 0 - opened.trace.drive_work_J
    sums["sum"] = sum(sums.values(), start=0 * energies.time_s)
    rows = [(part, f"{values[0]:.6g}", f"{values[-1]:.6g}") for part, values in sums.items()]
    print(*text_table([("energy (J)", "at time 0", "at the end"), *rows]), sep="\n")
    lines = [(bodies, *(f"{value:.6g}" for value in of_range.values())) for bodies, of_range in numbers.items()]
    if numbers:
        print(*text_table([("bodies", *next(iter(numbers.values()))), *lines]), sep="\n")
    table = results / f"{name}.parquet"
    written = write_product(draw_energies(energies, ranges, title), name, results)
    write_energies(energies, table)
    print_paths([*written, table])


@command("yade:fig4-tube --sideways 10")
@options.RUN
@options.FRAMES
@option(
    "--sideways",
    "X",
    "Multiply displacements from the axis by X (default: 1).",
    default=1.0,
    type=number(float, lambda factor: 0 < factor <= 1e6, "a factor above 0, up to 1e6"),
)
@options.RUNS_READ
@options.RESULTS
def film(run: str, frames: int | None, sideways: float, runs: Path, results: Path) -> None:
    """Draw the chain of a run at several times, and an animated GIF."""
    from postproc.draw import film as films
    from postproc.draw.product import write_product

    opened, name, title = _open("film", run, runs)
    still = films.film_of(opened, frames or films.FRAMES, sideways)
    print_paths(write_product(films.sheet(still, title), name, results))
    moving = films.film_of(opened, films.GIF_FRAMES, sideways)
    print_paths([films.write_animation(moving, title, results / f"{name}.gif")])


@command("yade:fig4 --frames 200")
@options.RUN
@options.FRAMES
@options.RUNS_READ
@options.RESULTS
def vtk(run: str, frames: int | None, runs: Path, results: Path) -> None:
    """Write a run for ParaView (needs recorded positions)."""
    from postproc.draw import vtk as series

    opened, name, _ = _open("vtk", run, runs)
    must_be_folder("--results", results / name)
    print_paths(series.write_series(opened, results / name, frames or series.FRAMES))


def _open(what: str, run: str, runs: Path) -> tuple["EndedRun", str, str]:
    """A run, a name for the files that a command makes from it, and a title."""
    from drivers.run.inventory import run_folder
    from drivers.run.run_folder import open_run

    opened = open_run(run_folder(run, runs), failed=True)
    if not opened.done:
        end_s, reason = opened.trace.time_s[-1], opened.record.reason
        print(f"{run}: {opened.record.status}, shown until {end_s:g} s: {reason}", file=sys.stderr)
    name = f"{what}-{opened.record.engine}-{opened.folder.resolve().name}"
    return opened, name, f"{opened.record.scene.get('title') or opened.record.scene_name} ({opened.record.engine})"
