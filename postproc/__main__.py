"""``python -m postproc``: the paper's figures, scenes drawn to scale, numbers from finished runs."""

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.base.command_line import Parser, must_be_folder, run_main
from drivers.base.errors import InputError, RunError

if TYPE_CHECKING:
    from drivers.run.finished import EndedRun

FIGURES = tuple(sorted(file.stem for file in (Path(__file__).parent / "figures").glob("[a-z]*.py")))


def main() -> int:
    """Reads the command line and does what it says."""
    parser = Parser(
        prog="python -m postproc", description="Figures, scenes drawn to scale, numbers from finished runs."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    observables = commands.add_parser("observables", help="peaks, speeds, widths, reflections, energies of a run")
    observables.add_argument("run", type=Path, metavar="RUN", help="a run folder")
    observables.add_argument(
        "--level",
        type=_share,
        action="append",
        metavar="X",
        help="cut widths at this share of the peak; repeatable (default: 0.002 and 0.04)",
    )
    observables.add_argument("--json", action="store_true", help="print JSON")
    observables.set_defaults(action=_observables)

    draw = commands.add_parser("draw", help="a scene drawn to scale")
    draw.add_argument("scene", metavar="SCENE", help="a scene file, or the name of one in inputs/scenes")
    draw.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings")
    _add_out(draw)
    draw.set_defaults(action=_draw)
    study = commands.add_parser("study", help="the figure of a study that has been run: curves, or a tornado chart")
    study.add_argument("study", metavar="STUDY", help="a study file, or the name of one in inputs/studies")
    study.add_argument("--results", type=Path, metavar="DIR", help="where its table is (default: results/)")
    _add_out(study)
    study.set_defaults(action=_study)
    _add_looks(commands)
    for name in (*FIGURES, "figures"):
        what = "all figures and the table" if name == "figures" else f"{name} of the paper, running what is not done"
        figure = commands.add_parser(name, help=what)
        figure.add_argument("--runs", type=Path, metavar="DIR", help="where run folders are (default: runs/)")
        _add_out(figure)
        figure.set_defaults(action=_figures, names=FIGURES if name == "figures" else (name,))
    arguments = parser.parse_args()
    return int(arguments.action(arguments))


def _add_looks(commands: "argparse._SubParsersAction[Parser]") -> None:
    """The commands that show a finished run."""
    for name, what, action in (
        ("vtk", "a run as a ParaView series; it has to keep positions (run.record)", _vtk),
        ("film", "the chain of a run at some times: a contact sheet and an animation", _film),
        ("spacetime", "the contact forces of a run over the whole chain against time", _spacetime),
    ):
        look = commands.add_parser(name, help=what)
        look.add_argument("run", type=Path, metavar="RUN", help="a run folder")
        if name != "spacetime":
            default = "100 frames" if name == "vtk" else "a sheet of 12"
            look.add_argument("--frames", type=_count, metavar="N", help=f"spread over the run (default: {default})")
        if name == "film":
            look.add_argument(
                "--sideways", type=_factor, default=1.0, metavar="X", help="exaggerate sideways displacements X times"
            )
        _add_out(look)
        look.set_defaults(action=action)


def _add_out(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=Path, metavar="DIR", help="folder to write to (default: results/)")


def _draw(arguments: argparse.Namespace) -> int:
    from drivers.base import paths
    from postproc.draw.product import Product, write_product
    from postproc.draw.scene_drawing import draw_scene
    from validation.accuracy.plan import planned_case

    must_be_folder("--out", arguments.out)
    case = planned_case(arguments.scene, *arguments.settings)
    product = Product(*draw_scene(case.scene, case.chain))
    for path in write_product(product, f"scene-{case.scene.name}", arguments.out or paths.RESULTS):
        print(paths.shown(path))
    return 0


def _study(arguments: argparse.Namespace) -> int:
    import pandas as pd

    from drivers.base import paths
    from drivers.batch.study import read_study
    from postproc.draw.product import write_product
    from postproc.draw.study_figure import draw_study, draw_tornado

    must_be_folder("--out", arguments.out)
    study = read_study(arguments.study)
    results = arguments.results or paths.RESULTS
    path = results / f"{study.name}.parquet"
    if not path.is_file():
        raise InputError(paths.shown(path), "", "no table", f"python -m drivers batch {arguments.study} makes it")
    draw = draw_tornado if study.one_by_one else draw_study
    product = draw(pd.read_parquet(path), study.title or study.name, study.figure, study.where)
    for written in write_product(product, f"{study.name}-figure", arguments.out or results):
        print(paths.shown(written))
    return 0


def _figures(arguments: argparse.Namespace) -> int:
    from importlib import import_module

    from drivers.base import paths
    from drivers.engines import missing_codes
    from postproc.draw.product import write_product

    must_be_folder("--out", arguments.out)
    must_be_folder("--runs", arguments.runs)
    code = 0
    for name in arguments.names:
        try:
            product = import_module(f"postproc.figures.{name}").make(arguments.runs or paths.RUNS)
        except (RunError, InputError) as error:  # the other figures are made all the same
            print(f"{name}: {error}", file=sys.stderr)
            code = max(code, 2 if isinstance(error, InputError) else 1)
            continue
        for path in write_product(product, name, arguments.out or paths.RESULTS):
            print(paths.shown(path), flush=True)
    if missing_codes():
        print(f"without what is not installed: {', '.join(missing_codes())}", file=sys.stderr)
    return code


def _vtk(arguments: argparse.Namespace) -> int:
    from drivers.base import paths
    from drivers.run.finished import open_run
    from postproc.draw.vtk import FRAMES, write_series

    must_be_folder("--out", arguments.out)
    run = open_run(arguments.run)
    folder = (arguments.out or paths.RESULTS) / f"vtk-{_name_of(run)}"
    must_be_folder("--out", folder)
    for written in write_series(run, folder, arguments.frames or FRAMES):
        print(paths.shown(written))
    return 0


def _film(arguments: argparse.Namespace) -> int:
    from drivers.base import paths
    from drivers.run.finished import open_run
    from postproc.draw.film import ANIMATED, FRAMES, film_of, sheet, write_animation
    from postproc.draw.product import write_product

    must_be_folder("--out", arguments.out)
    run, out = open_run(arguments.run), arguments.out or paths.RESULTS
    name = f"film-{_name_of(run)}"
    product = sheet(film_of(run, arguments.frames or FRAMES, arguments.sideways), _title_of(run))
    for path in write_product(product, name, out):
        print(paths.shown(path))
    print(paths.shown(write_animation(film_of(run, ANIMATED, arguments.sideways), _title_of(run), out / f"{name}.gif")))
    return 0


def _spacetime(arguments: argparse.Namespace) -> int:
    from drivers.base import paths
    from drivers.run.finished import open_run
    from postproc.draw.product import write_product
    from postproc.draw.spacetime import Panel, spacetime_product

    must_be_folder("--out", arguments.out)
    run = open_run(arguments.run)
    product = spacetime_product([Panel(_title_of(run), run.trace)], 6.4)
    for path in write_product(product, f"spacetime-{_name_of(run)}", arguments.out or paths.RESULTS):
        print(paths.shown(path))
    return 0


def _name_of(run: "EndedRun") -> str:
    """What is made of a run is named after its engine and its folder."""
    return f"{run.record.engine}-{run.folder.resolve().name}"


def _title_of(run: "EndedRun") -> str:
    return f"{run.record.scene.get('title') or run.record.scene_name} ({run.record.engine})"


def _count(text: str) -> int:
    if not text.isascii() or not text.isdigit() or not 2 <= int(text) <= 10_000:
        raise argparse.ArgumentTypeError(f"found {text}; allowed: whole numbers from 2 to 10000")
    return int(text)


def _factor(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value <= 1e6:
        raise argparse.ArgumentTypeError(f"found {text}; allowed: a factor above 0, up to 1e6")
    return value


def _share(text: str) -> float:
    value = float(text)
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"{text} is no share of the peak: expected above 0 and below 1")
    return value


def _observables(arguments: argparse.Namespace) -> int:
    from drivers.run.finished import open_run
    from postproc.read.observables import LEVELS, observe

    run = open_run(arguments.run)
    values = observe(run.layout, run.trace, tuple(arguments.level or LEVELS))
    if arguments.json:
        print(json.dumps({name: None if value != value else value for name, value in values.items()}, indent=2))
        return 0
    width = max(map(len, values))
    for name, value in values.items():
        print(f"{name:<{width}}  {'not seen' if value != value else format(value, '.6g')}")
    return 0


if __name__ == "__main__":
    run_main(main)
