"""``python -m drivers``: renders decks and runs them."""

import argparse
import sys
from pathlib import Path

from drivers.cli import Parser, must_be_folder, run_main
from drivers.errors import InputError, RunError


def main() -> int:
    """Reads the command line and does what it says."""
    arguments = _parser().parse_args()
    return int(arguments.action(arguments))


def _parser() -> Parser:
    parser = Parser(prog="python -m drivers", description="Scene files to decks to runs.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    render = commands.add_parser("render", help="write an engine's deck for a scene")
    _add_scene(render)
    render.add_argument("--engine", required=True, metavar="E", help="liggghts, yade, verlet or reference")
    render.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder to write the deck to")
    render.set_defaults(action=_render)

    run = commands.add_parser("run", help="run a scene and print the run folders")
    _add_scene(run)
    run.add_argument("--engine", action="append", metavar="E", help="repeatable; without it: all that are installed")
    run.add_argument("--runs", type=Path, metavar="DIR", help="where run folders go (default: runs/ of the checkout)")
    run.add_argument("--rerun", action="store_true", help="run again what is done")
    run.add_argument("--time-limit", type=_seconds, metavar="S", help="seconds after which a run is killed")
    run.set_defaults(action=_run)
    return parser


def _add_scene(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scene", metavar="SCENE", help="a scene file, or the name of one in inputs/scenes")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        dest="settings",
        help="lay a value over the scene, such as chain.count=60 or run.time_step='10 ns'; empty: leave the key out",
    )


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"found {text}; allowed: seconds above zero")
    return value


def _engines(asked: list[str] | None) -> tuple[list[str], list[str]]:
    """Engines to run and engines left out because nobody asked for them and they are not installed."""
    from drivers.engines import engine_names, load_engine

    names = engine_names()
    for name in asked or []:
        if name not in names:
            raise InputError("--engine", "", f'"{name}"', ", ".join(names))
    if asked:
        return list(dict.fromkeys(asked)), []
    missing = [name for name in names if load_engine(name).find() is None]
    return [name for name in names if name not in missing], missing


def _render(arguments: argparse.Namespace) -> int:
    from drivers.case import build_case
    from drivers.engines import load_engine
    from drivers.read_scene import read_scene

    (name,), _ = _engines([arguments.engine])
    deck = load_engine(name).render(build_case(read_scene(arguments.scene, tuple(arguments.settings))))
    must_be_folder("--out", arguments.out)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for file, text in deck.files.items():
        (arguments.out / file).write_text(text)
        print(arguments.out / file)
    return 0


def _run(arguments: argparse.Namespace) -> int:
    from drivers import paths
    from drivers.case import build_case
    from drivers.read_scene import read_scene
    from drivers.run import run_case

    names, missing = _engines(arguments.engine)
    case = build_case(read_scene(arguments.scene, tuple(arguments.settings)))
    runs = arguments.runs or paths.RUNS
    must_be_folder("--runs", runs)
    failures = 0
    for name in names:
        try:
            finished = run_case(case, name, runs, rerun=arguments.rerun, limit_s=arguments.time_limit)
        except (RunError, OSError) as error:
            print(f"{case.scene.name}: {name}: {error}", file=sys.stderr)
            failures += 1
            continue
        print(paths.shown(finished.folder), flush=True)
        if not finished.done:
            print(f"{case.scene.name}: {name} {finished.record.status}: {finished.record.reason}", file=sys.stderr)
            failures += 1
    if missing:
        print(f"not run, since not installed ({len(missing)}): {', '.join(missing)}", file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    run_main(main)
