# PYTHON_ARGCOMPLETE_OK
"""``python -m postproc``: the paper's figures, scenes drawn to scale, numbers from finished runs."""

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import drivers.environment  # noqa: F401 - before anything that it lacks
from drivers.base import paths
from drivers.base.command_line import Parser, engines_file, must_be_folder, run_main
from drivers.base.errors import InputError, RunError
from drivers.base.progress import step
from postproc.figures import captions, make_figure

if TYPE_CHECKING:
    from drivers.run.finished import EndedRun
    from drivers.scene.model import Scene
    from postproc.draw.product import Product

Action = Callable[[argparse.Namespace], Iterable[Path]]  # does what a command says, and names the files it has written
Options = dict[str, dict[str, Any]]  # of a command, with what argparse needs to know of them


def main() -> int:
    """Reads the command line and does what it says."""
    parser = Parser(
        prog="python -m postproc", description="Figures, scenes drawn to scale, numbers from finished runs."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    drawn = {name: (caption.title, _figures, RUNS) for name, caption in captions().items()}
    for name, (words, action, options) in (COMMANDS | drawn).items():
        command = commands.add_parser(name, help=words)
        for option, look in options.items():
            command.add_argument(option, **look)
        command.set_defaults(action=action, command=name)
    arguments = parser.parse_args()
    for option in ("out", "runs")[: 1 if "run" in arguments else 2]:  # nothing is written beside a run that is read
        must_be_folder(f"--{option}", getattr(arguments, option, None))
    for path in arguments.action(arguments):
        print(paths.shown(path), flush=True)
    return 0


def _write(arguments: argparse.Namespace, product: "Product", name: str, results: Path = paths.RESULTS) -> list[Path]:
    from postproc.draw.product import write_product

    return write_product(product, name, arguments.out or results)


def _observables(arguments: argparse.Namespace) -> Iterable[Path]:
    from postproc.read.observables import LEVELS, observe

    run, _, _ = _open(arguments)
    observed = observe(run.layout, run.trace, tuple(arguments.level or LEVELS))
    values = {name: None if isnan(value) else value for name, value in observed.items()}
    width = max(map(len, values))
    shown = {name: "not seen" if value is None else format(value, ".6g") for name, value in values.items()}
    lines = "\n".join(f"{name:<{width}}  {value}" for name, value in shown.items())
    print(json.dumps(values, indent=2) if arguments.json else lines)
    return ()


def _draw(arguments: argparse.Namespace) -> Iterable[Path]:
    from postproc.draw.product import Product
    from postproc.draw.scene_drawing import draw_scene
    from validation.accuracy.plan import planned_case

    case = planned_case(arguments.scene, *arguments.settings)
    return _write(arguments, Product(*draw_scene(case.scene, case.chain)), f"scene-{case.scene.name}")


def _study(arguments: argparse.Namespace) -> Iterable[Path]:
    import pandas as pd

    from drivers.batch.study import column_name, read_study
    from postproc.draw.study_figure import draw_study, draw_tornado
    from postproc.read.labels import key_label

    study, results = read_study(arguments.study), arguments.results or paths.RESULTS
    path = results / f"{study.name}.parquet"
    if not path.is_file():
        raise InputError(paths.shown(path), "", "no table", f"python -m drivers batch {arguments.study} makes it")
    draw = draw_tornado if study.one_by_one else draw_study
    labels = {column_name(name, key): key_label(name, key) for name, key in study.columns.items()}
    product = draw(pd.read_parquet(path), study.file.title or study.name, study.file.figure, study.where, labels)
    return _write(arguments, product, f"{study.name}-figure", results)


def _figures(arguments: argparse.Namespace) -> Iterator[Path]:
    """Makes one figure, or all: one that cannot be made leaves the others."""
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
        print(f"without what is not installed: {', '.join(missing_codes())}", file=sys.stderr)
    if code:
        sys.exit(code)


def _vtk(arguments: argparse.Namespace) -> Iterable[Path]:
    from postproc.draw import vtk

    run, name, _ = _open(arguments)
    folder = (arguments.out or paths.RESULTS) / name
    must_be_folder("--out", folder)
    return vtk.write_series(run, folder, arguments.frames or vtk.FRAMES)


def _film(arguments: argparse.Namespace) -> Iterator[Path]:
    from postproc.draw import film

    run, name, title = _open(arguments)
    still = film.film_of(run, arguments.frames or film.FRAMES, arguments.sideways)
    yield from _write(arguments, film.sheet(still, title), name)
    moving = film.film_of(run, film.ANIMATED, arguments.sideways)
    yield film.write_animation(moving, title, (arguments.out or paths.RESULTS) / f"{name}.gif")


def _spacetime(arguments: argparse.Namespace) -> Iterable[Path]:
    from postproc.draw.product import draw_spacetime

    run, name, title = _open(arguments)
    return _write(arguments, draw_spacetime({title: run.trace}, width_in=6.4), name)


def _overlay(arguments: argparse.Namespace) -> Iterable[Path]:
    """Lays measured traces over a run, or over the exact motion of a scene, and prints the misfits."""
    from drivers.engines import REFERENCE
    from drivers.limits.refusal import refuse
    from postproc.draw.overlay import HEADINGS, draw_overlay, misfit_rows
    from postproc.paper.simulate import exact
    from postproc.read.measured import entries_of
    from postproc.read.misfit import lay_over
    from validation.accuracy.plan import planned_case

    if _names_run(arguments.run):
        if arguments.settings:
            raise InputError(f"--set {arguments.settings[0]}", "", "settings for a run", "settings for a scene")
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
    rows = [HEADINGS, *misfit_rows(found)]
    widths = [max(len(row[place]) for row in rows) for place in range(len(HEADINGS))]
    for row in rows:
        print("  ".join(f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)).rstrip())
    return written


def _names_run(source: str) -> bool:
    """Whether a command's argument is a run folder or ``ENGINE:SCENE`` rather than a scene."""
    return Path(source).is_dir() or (":" in source and not Path(source).exists())


def _scene_of(run: "EndedRun", source: str) -> "Scene | None":
    """The scene of a run as its file is now; None where that is gone or wrong."""
    from drivers.scene.read_scene import read_scene

    _, _, named = source.partition(":")
    for path in (named, run.record.scene_name, f"{run.record.scene_name}.toml"):
        with suppress(InputError):
            return read_scene(path)
    return None


def _open(arguments: argparse.Namespace) -> tuple["EndedRun", str, str]:
    """A command's run, the name of what is made of it, after its engine and its folder, and its title."""
    from drivers.inventory.run_folders import run_folder
    from drivers.run.finished import open_run

    run = open_run(run_folder(arguments.run, arguments.runs or paths.RUNS))
    name = f"{arguments.command}-{run.record.engine}-{run.folder.resolve().name}"
    return run, name, f"{run.record.scene.get('title') or run.record.scene_name} ({run.record.engine})"


def _number(kind: Callable[[str], float], allowed: Callable[[float], bool], words: str) -> Callable[[str], float]:
    """A reader of an option's number."""

    def read(text: str) -> float:
        with suppress(ValueError):
            if allowed(value := kind(text)):
                return value
        raise argparse.ArgumentTypeError(f"found {text}; allowed: {words}")

    return read


FOLDER = {"type": Path, "metavar": "DIR"}
OUT: Options = {"--out": {**FOLDER, "help": "folder to write to (default: results/)"}}
ENGINES: Options = {
    "--engines": {"type": engines_file, "metavar": "FILE", "help": "entries of own builds and adapters"}
}
FROM: Options = {"--runs": {**FOLDER, "help": "where run folders are (default: runs/)"}}
RUNS: Options = {**ENGINES, **FROM, **OUT}
RUN: Options = {"run": {"metavar": "RUN", "help": "a run folder, or ENGINE:SCENE for the newest"}, **FROM}
SCENE: Options = {
    "scene": {"metavar": "SCENE", "help": "a scene file, or the name of one in inputs/scenes"},
    "--set": {"action": "append", "default": [], "metavar": "KEY=VALUE", "dest": "settings"},
}
OVER: Options = {
    "run": {"metavar": "SCENE|RUN", "help": "a scene, for its exact motion, or a run as other commands take it"},
    "--set": SCENE["--set"],
    "--measured": {"type": Path, "metavar": "FILE", "help": "a CSV file (default: [[measured]] of the scene)"},
    **FROM,
    **OUT,
}
STUDY: Options = {
    "study": {"metavar": "STUDY", "help": "a study file, or the name of one in inputs/studies"},
    "--results": {**FOLDER, "help": "where its table is (default: results/)"},
}
FRAMES: Options = {
    "--frames": {"metavar": "N", "help": "spread over the run (default: 100, and 12 on a sheet)",
                 "type": _number(int, lambda count: 2 <= count <= 10_000, "whole numbers from 2 to 10000")},
}  # fmt: skip
SIDEWAYS: Options = {
    "--sideways": {"metavar": "X", "default": 1.0, "help": "exaggerate sideways displacements X times",
                   "type": _number(float, lambda factor: 0 < factor <= 1e6, "a factor above 0, up to 1e6")},
}  # fmt: skip
SHOWN: Options = {
    "--level": {"metavar": "X", "action": "append",
                "help": "cut widths at this share of the peak; repeatable (default: 0.002 and 0.04)",
                "type": _number(float, lambda share: 0 < share < 1, "a share of the peak, above 0 and below 1")},
    "--json": {"action": "store_true", "help": "print JSON"},
}  # fmt: skip
COMMANDS: dict[str, tuple[str, Action, Options]] = {
    "observables": ("peaks, speeds, widths, reflections, energies of a run", _observables, RUN | SHOWN),
    "draw": ("a scene drawn to scale", _draw, SCENE | OUT),
    "overlay": ("measured traces over computed ones, and how far off they are", _overlay, OVER),
    "study": ("the figure of a study that has been run: curves, or a tornado chart", _study, STUDY | ENGINES | OUT),
    "vtk": ("a run as a ParaView series; it has to keep positions (run.record)", _vtk, RUN | FRAMES | OUT),
    "film": ("a run's chain at some times: a contact sheet and an animation", _film, RUN | FRAMES | SIDEWAYS | OUT),
    "spacetime": ("the contact forces of a run over the whole chain against time", _spacetime, RUN | OUT),
    "figures": ("all figures and the table", _figures, RUNS),
}

if __name__ == "__main__":
    run_main(main)
