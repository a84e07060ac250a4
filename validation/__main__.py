# PYTHON_ARGCOMPLETE_OK
"""``python -m validation``: compares runs, measures what models and steps do, and writes the report."""

import argparse
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import drivers.environment  # noqa: F401 - before anything that it lacks
from drivers.base import paths
from drivers.base.command_line import Parser, engines_file, must_be_file, must_be_folder, run_main, seconds
from drivers.base.errors import InputError

if TYPE_CHECKING:
    from validation.compare.asked import Asked


def _names(text: str) -> tuple[str, ...]:
    """Reads names with commas between them."""
    return tuple(name.strip() for name in text.split(","))


SEVERAL: dict[str, Any] = {"action": "append", "default": []}
OPTIONS: dict[str, dict[str, Any]] = {
    "what": {
        "nargs": "*",
        "metavar": "SCENE|RUN RUN",
        "help": "scene files or names; or two run folders; none: all there are",
    },
    "name": {"metavar": "NAME", "help": "an engine, such as verlet, or an entry of an engines.toml"},
    "scenes": {"nargs": "*", "metavar": "SCENE", "help": "default: the paper's four (of fit: those of the data)"},
    "--set": SEVERAL | {"metavar": "KEY=VALUE", "dest": "settings"},
    "--unsafe": {"action": "store_true", "help": "run what a guard refuses"},
    "--budget": {
        "type": seconds,
        "metavar": "S",
        "dest": "budget_s",
        "help": "engine time in all (default: 300 s; of the short study 30 s)",
    },
    "--quick": {"action": "store_true", "help": "short: fewer scenes, steps and seeds, no long runs; a fit alone"},
    "--studies": {"action": "store_true", "help": "let the page grow by the studies, short ones where none was made"},
    "--free": SEVERAL
    | {"metavar": "KEY[=LOW..HIGH]", "help": "a key of the scene whose value is to be found; repeatable"},
    "--own": SEVERAL | {"metavar": "KEY[=LOW..HIGH]", "help": "likewise, for each data set by itself; repeatable"},
    "--quoted": {"type": _names, "default": (), "metavar": "SET,...", "help": "data that the paper quotes"},
    "--measured": {"type": Path, "metavar": "FILE", "help": "a measured trace (default: [[measured]] of the scenes)"},
    "--engines": {"type": engines_file, "metavar": "FILE", "help": "entries of own builds and adapters (engines.toml)"},
    "--file": {"type": Path, "metavar": "FILE", "help": "cases (default: inputs/independent.toml)"},
    "--out": {"type": Path, "metavar": "FILE", "help": "default: results/report.html"},
    "--results": {"type": Path, "metavar": "DIR", "help": "default: results/"},
    "--runs": {"type": Path, "metavar": "DIR", "help": "where run folders are (default: runs/)"},
    "--against": {"type": Path, "metavar": "NEW", "help": "a folder of runs, to be compared with those of --runs"},
    "--engine": SEVERAL | {"metavar": "E", "help": "compare these beside the yardsticks; repeatable"},
    "--require": SEVERAL | {"metavar": "E", "help": "an engine that has to run, or it is a failure; repeatable"},
    "--allow-missing": {
        "action": "store_true",
        "help": "engines of --engine, codes and runs of --against may be missing",
    },
}
CHECKS = {"results": must_be_folder, "runs": must_be_folder, "out": must_be_file}


def main() -> int:
    """Reads the command line and does what it says."""
    arguments = _parser().parse_args()
    for option, check in CHECKS.items():
        if not (option == "runs" and getattr(arguments, "against", None)):  # of which nothing is written
            check(f"--{option}", getattr(arguments, option, None))
    return int(arguments.action(arguments))


def _asked(arguments: argparse.Namespace) -> "Asked":
    """Engines that are asked for; InputError where there is no such engine."""
    from drivers.engines import load_engine
    from validation.compare.asked import Asked

    for option in ("engine", "require"):
        for name in getattr(arguments, option):
            load_engine(name, f"--{option}")
    return Asked(tuple(arguments.engine), tuple(arguments.require), arguments.allow_missing)


def _compare(arguments: argparse.Namespace) -> int:
    asked, runs = _asked(arguments), arguments.runs or paths.RUNS
    folders = [what for what in arguments.what if Path(what).is_dir() or ":" in what]
    if folders:
        if len(folders) != 2 or len(arguments.what) != 2:
            raise InputError("compare", "", " ".join(arguments.what), "scenes, or exactly two run folders")
        for option in ("settings", "engine", "require", "against"):
            if getattr(arguments, option):
                words = option.replace("settings", "set")
                raise InputError(f"--{words}", "", "two runs that are done", "an option for scenes")
        from drivers.inventory.run_folders import run_folder
        from validation.compare.pair import compare_runs

        return compare_runs(*(run_folder(folder, runs) for folder in folders))
    if arguments.against:
        if arguments.settings:
            raise InputError("--set", "", "runs that are done", "an option for scenes to be run")
        from validation.compare.moved import compare_folders

        return compare_folders(runs, arguments.against, arguments.what, asked)
    if not arguments.what and not asked.builds:
        allowed = "scenes, two run folders, --against NEW, or --engine twice with builds of one code"
        raise InputError("compare", "", "no scene", allowed)
    from validation.compare.comparison import compare_scenes

    return compare_scenes(arguments.what, tuple(arguments.settings), runs, asked, unsafe=arguments.unsafe)


def _report(arguments: argparse.Namespace) -> int:
    from validation.report.write_report import report

    return report(arguments.scenes, arguments.out, arguments.runs, _asked(arguments), studies=arguments.studies)


def _study(arguments: argparse.Namespace) -> int:
    from validation.studies import Options, load_study, run_study

    given = {key: value for key, value in vars(arguments).items() if value is not None}
    options = Options(**{field.name: given[field.name] for field in fields(Options) if field.name in given})
    return run_study(load_study(arguments.command), options)


def _fit(arguments: argparse.Namespace) -> int:
    from validation.calibration.fit_command import Wanted, run_fit

    given = {field.name: getattr(arguments, field.name) for field in fields(Wanted)}
    return run_fit(Wanted(**given), arguments.runs or paths.RUNS, arguments.results or paths.RESULTS)


def _engine(arguments: argparse.Namespace) -> int:
    from validation.kit.judge import judge_engine

    return judge_engine(arguments.name, arguments.runs or paths.RUNS, arguments.results)


def _wave(_: argparse.Namespace) -> int:
    from validation.reference.travelling_wave import constants, solve_travelling_wave

    print("\n".join(constants(solve_travelling_wave())))
    return 0


WHICH = "--runs --engine --require --allow-missing"
# by name: what it does, how, and its options
COMMANDS: dict[str, tuple[Callable[[argparse.Namespace], int], str, str]] = {
    "compare": (
        _compare,
        "verdicts on scenes, run where needed; or how two runs, or those of two folders, differ",
        f"what --set {WHICH} --against --unsafe",
    ),
    "report": (_report, "write the report page, and its verdicts for programs", f"scenes --studies --out {WHICH}"),
    "claims": (_study, "compute and judge every quantitative statement of the paper", "--results --runs"),
    "trade": (_study, "errors against cost, for all engines and steps, and what to use", "--quick --budget --results"),
    "stability": (_study, "limits of the time step, extremes, long runs, rounding", "--quick --results --runs"),
    "elements": (_study, "what each modelling element adds and costs, step by step", "--quick --results --runs"),
    "independent": (_study, "beyond the paper, against published numbers and theory", "--file --results --runs"),
    "calibration": (_study, "parameters that the paper's experiments ask for, and how surely", "--quick --results"),
    "fit": (
        _fit,
        "find parameters of scenes by measured data, how surely, and let the codes confirm them",
        "scenes --free --own --measured --quoted --set --quick --results --runs",
    ),
    "engine": (_engine, "judge an adapter or a build: interface, decks, output, physics", "name --results --runs"),
    "wave": (_wave, "constants of the exact solitary wave of the discrete chain", ""),
}


def _parser() -> Parser:
    parser = Parser(prog="python -m validation", description="How far runs are from an independent reference.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")
    for name, (action, summary, options) in COMMANDS.items():
        command = commands.add_parser(name, help=summary)
        for option in (*options.split(), *["--engines"] * bool(options)):
            command.add_argument(option, **OPTIONS[option])
        command.set_defaults(action=action)
    return parser


if __name__ == "__main__":
    run_main(main)
