# PYTHON_ARGCOMPLETE_OK
"""``python -m postproc``: draws figures and scenes, and reads numbers from finished runs."""

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING

import drivers.environment  # noqa: F401 - checks the environment before further imports
from drivers.base import command_line, paths
from drivers.base.command_line import Command, Options, argument
from drivers.base.errors import InputError, RunError
from drivers.base.progress import step
from drivers.base.text_table import text_table
from postproc.figures import captions, make_figure

if TYPE_CHECKING:
    from drivers.run.run_folder import EndedRun
    from drivers.scene.model import Scene
    from postproc.draw.product import Product


def main() -> int:
    """Runs the command line and returns its exit code."""
    arguments = _parser().parse_args()
    for option in ("out", "runs")[: 1 if "run" in arguments else 2]:  # a run is only read
        command_line.must_be_folder(f"--{option}", getattr(arguments, option, None))
    for path in arguments.action(arguments):
        print(paths.shown(path), flush=True)
    return 0


def _write(arguments: argparse.Namespace, product: "Product", name: str, results: Path = paths.RESULTS) -> list[Path]:
    from postproc.draw.product import write_product

    return write_product(product, name, arguments.out or results)


def _observables(arguments: argparse.Namespace) -> Iterable[Path]:
    from postproc.read.observables import LEVELS, observe, without_unit

    run, _, _ = _open(arguments)
    observed = observe(run.layout, run.trace, tuple(arguments.level or LEVELS))
    values = {name: None if isnan(value) else value for name, value in observed.items()}
    if arguments.json:
        print(json.dumps(values, indent=2))
        return ()
    errors = {part["quantity"]: f"{abs(part['whole']):.1e}" for part in run.record.error_budget or ()}
    shown = {name: "not seen" if value is None else f"{value:.6g}" for name, value in values.items()}
    rows = [(name, value, errors.get(without_unit(name), "")) for name, value in shown.items()]
    print(*text_table([("observable", "value", "relative error"), *rows]), sep="\n")
    return ()


def _draw(arguments: argparse.Namespace) -> Iterable[Path]:
    from postproc.draw.product import Product
    from postproc.draw.scene_drawing import draw_scene
    from validation.accuracy.plan import planned_case

    case = planned_case(arguments.scene, *arguments.settings)
    return _write(arguments, Product(*draw_scene(case.scene, case.chain)), f"scene-{case.scene.name}")


def _study(arguments: argparse.Namespace) -> Iterable[Path]:
    from drivers.batch.study import column_name, read_study
    from drivers.batch.study_table import read_study_table
    from postproc.draw.study_figure import draw_study, draw_tornado
    from postproc.read.labels import key_label

    study, results = read_study(arguments.study), arguments.results or paths.RESULTS
    table = read_study_table(arguments.study, results)
    draw = draw_tornado if study.one_by_one else draw_study
    labels = {column_name(name, key): key_label(name, key) for name, key in study.columns.items()}
    product = draw(table, study.file.title or study.name, study.file.figure, study.where, labels)
    return _write(arguments, product, f"{study.name}-figure", results)


def _figures(arguments: argparse.Namespace) -> Iterator[Path]:
    """Makes one figure or all; a failed figure does not stop the others."""
    from drivers.engines import missing_codes

    titles, code = {name: caption.title for name, caption in captions().items()}, 0
    names = [*titles] if arguments.command == "figures" else [arguments.command]
    for number, name in enumerate(names, 1):
        try:
            with step(f"{name}: {titles[name]}", number, len(names)):
                product = make_figure(name, arguments.runs or paths.RUNS)
                written = _write(arguments, product, name)
        except (RunError, InputError) as error:
            print(f"{name}: {error}", file=sys.stderr)
            code = max(code, 2 if isinstance(error, InputError) else 1)
        else:
            yield from written
    if missing_codes():
        print(f"left out, since not installed: {', '.join(missing_codes())}", file=sys.stderr)
    if code:
        sys.exit(code)


def _vtk(arguments: argparse.Namespace) -> Iterable[Path]:
    from postproc.draw import vtk

    run, name, _ = _open(arguments)
    folder = (arguments.out or paths.RESULTS) / name
    command_line.must_be_folder("--out", folder)
    return vtk.write_series(run, folder, arguments.frames or vtk.FRAMES)


def _film(arguments: argparse.Namespace) -> Iterator[Path]:
    from postproc.draw import film

    run, name, title = _open(arguments)
    still = film.film_of(run, arguments.frames or film.FRAMES, arguments.sideways)
    yield from _write(arguments, film.sheet(still, title), name)
    moving = film.film_of(run, film.GIF_FRAMES, arguments.sideways)
    yield film.write_animation(moving, title, (arguments.out or paths.RESULTS) / f"{name}.gif")


def _spacetime(arguments: argparse.Namespace) -> Iterable[Path]:
    from postproc.draw.product import draw_spacetime

    run, name, title = _open(arguments)
    return _write(arguments, draw_spacetime({title: run.trace}, width_in=6.4), name)


def _overlay(arguments: argparse.Namespace) -> Iterable[Path]:
    """Draws measured traces over a run, or over the exact motion of a scene, and prints the misfits."""
    from drivers.engines import REFERENCE
    from drivers.limits.refusal import refuse
    from postproc.draw.overlay import HEADINGS, draw_overlay, misfit_rows
    from postproc.paper.simulate import exact
    from postproc.read.measured import entries_of
    from postproc.read.misfit import lay_over
    from validation.accuracy.plan import planned_case

    if _names_run(arguments.run):
        if arguments.settings:
            raise InputError(f"--set {arguments.settings[0]}", "", "not allowed for a finished run")
        run, name, _ = _open(arguments)
        scene, layout, trace, engine = _scene_of(run, arguments.run), run.layout, run.trace, run.record.engine
    else:
        case = planned_case(arguments.run, *arguments.settings)
        refuse(case, REFERENCE)
        scene, layout, trace, engine = case.scene, case.layout, exact(case).trace, REFERENCE
        name = f"overlay-{scene.name}"
    entries, folder, where = entries_of(scene, arguments.measured, arguments.run)
    curves, found = lay_over(entries, folder, where, layout, trace)
    written = _write(arguments, draw_overlay(layout, trace, engine, curves, found), name) if curves else ()
    print(*text_table([HEADINGS, *misfit_rows(found)]), sep="\n")
    return written


def _names_run(source: str) -> bool:
    """True if a command's argument is a run folder or ``ENGINE:SCENE``, not a scene."""
    return Path(source).is_dir() or (":" in source and not Path(source).exists())


def _scene_of(run: "EndedRun", source: str) -> "Scene | None":
    """The scene of a run, read again from its file; None if the file is missing or wrong."""
    from drivers.scene.read_scene import read_scene

    _, _, named = source.partition(":")
    for path in (named, run.record.scene_name, f"{run.record.scene_name}.toml"):
        with suppress(InputError):
            return read_scene(path)
    return None


def _open(arguments: argparse.Namespace) -> tuple["EndedRun", str, str]:
    """The run of a command, a name for the files made from that run, and a title."""
    from drivers.inventory.run_folders import run_folder
    from drivers.run.run_folder import open_run

    run = open_run(run_folder(arguments.run, arguments.runs or paths.RUNS))
    name = f"{arguments.command}-{run.record.engine}-{run.folder.resolve().name}"
    return run, name, f"{run.record.scene.get('title') or run.record.scene_name} ({run.record.engine})"


def _number(kind: Callable[[str], float], allowed: Callable[[float], bool], words: str) -> Callable[[str], float]:
    """Reader of a number within limits, for argparse."""

    def read(text: str) -> float:
        with suppress(ValueError):
            if allowed(value := kind(text)):
                return value
        raise argparse.ArgumentTypeError(f"found {text}; allowed: {words}")

    return read


OUT = argument("--out", "folder for the files (default: results/ of the checkout)", "DIR", type=Path)
RUNS = command_line.ENGINES | command_line.RUNS | OUT
RUN = argument("run", "a run folder, or ENGINE:SCENE for the newest run of that scene", "RUN") | command_line.RUNS
SCENE = command_line.SCENE | command_line.SETTINGS
OVERLAY = (
    argument("run", "a scene, for its exact motion; or a run folder, or ENGINE:SCENE", "SCENE|RUN")
    | command_line.SETTINGS
    | command_line.MEASURED
    | command_line.RUNS
    | OUT
)
STUDY = command_line.STUDY | argument(
    "--results", "folder of the table (default: results/ of the checkout)", "DIR", type=Path
)


def _frames(default: int) -> Options:
    """Option for the number of times."""
    kind = _number(int, lambda count: 2 <= count <= 10_000, "whole numbers from 2 to 10000")
    return argument("--frames", f"number of times (default: {default})", "N", type=kind)


SIDEWAYS = argument(
    "--sideways",
    "multiply displacements from the axis by X (default: 1)",
    "X",
    default=1.0,
    type=_number(float, lambda factor: 0 < factor <= 1e6, "a factor above 0, up to 1e6"),
)
OBSERVABLES = argument(
    "--level",
    "measure widths at this share of the peak; repeatable (default: 0.002 and 0.04)",
    "X",
    action="append",
    type=_number(float, lambda share: 0 < share < 1, "a share of the peak, above 0 and below 1"),
) | argument("--json", "print JSON")
COMMANDS = {
    "observables": Command(
        _observables,
        "print peaks, speeds, widths, reflections, energies of a run",
        RUN | OBSERVABLES,
        ("yade:fig4", "yade:fig4 --level 0.1 --json"),
    ),
    "draw": Command(_draw, "draw a scene to scale", SCENE | OUT, ("fig4", "fig4 --set chain.count=5 --out drawings")),
    "overlay": Command(
        _overlay,
        "draw measured traces over computed ones, with deviations",
        OVERLAY,
        ("example-measured", "example-measured --set contact.restitution=0.9", "yade:fig4 --measured shot-12.csv"),
    ),
    "study": Command(
        _study,
        "draw the table of a finished study: curves or a tornado chart",
        STUDY | command_line.ENGINES | OUT,
        ("sensitivity",),
    ),
    "vtk": Command(
        _vtk,
        "write a run for ParaView (needs recorded positions)",
        RUN | _frames(100) | OUT,
        ("yade:fig4 --frames 200",),
    ),
    "film": Command(
        _film,
        "draw the chain of a run at several times, and an animated GIF",
        RUN | _frames(12) | SIDEWAYS | OUT,
        ("yade:fig4-tube --sideways 10",),
    ),
    "spacetime": Command(
        _spacetime, "draw the force in every contact of a run against time", RUN | OUT, ("yade:fig4",)
    ),
    "figures": Command(_figures, "make all figures and the table of the paper", RUNS),
}


def _parser() -> command_line.Parser:
    summary = "draw figures and scenes, and read numbers from finished runs"
    drawn = {name: Command(_figures, caption.title, RUNS) for name, caption in captions().items()}
    first = ["fig4", "draw fig4", "observables yade:fig4"]
    return command_line.build_parser("python -m postproc", summary, first, COMMANDS | drawn)


if __name__ == "__main__":
    command_line.run_main(main)
