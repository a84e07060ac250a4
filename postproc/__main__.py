"""``python -m postproc``: numbers from finished runs."""

import argparse
import json
from pathlib import Path

from drivers.cli import Parser, run_main


def main() -> int:
    """Reads the command line and does what it says."""
    parser = Parser(prog="python -m postproc", description="Numbers from finished runs.")
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
    arguments = parser.parse_args()
    return int(arguments.action(arguments))


def _share(text: str) -> float:
    value = float(text)
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(f"{text} is no share of the peak: expected above 0 and below 1")
    return value


def _observables(arguments: argparse.Namespace) -> int:
    from drivers.finished import open_run
    from postproc.observables import LEVELS, observe

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
