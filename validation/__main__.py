# PYTHON_ARGCOMPLETE_OK
"""``python -m validation``: compares runs, measures errors and limits, and writes the report."""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import drivers.environment  # noqa: F401 - checks the environment before further imports
from drivers.base import command_line, paths
from drivers.base.errors import InputError

if TYPE_CHECKING:
    from validation.compare.selection import EngineSelection


def _names(text: str) -> tuple[str, ...]:
    """Reads names that are separated by commas."""
    return tuple(name.strip() for name in text.split(","))


SEVERAL: dict[str, Any] = {"action": "append", "default": []}
OPTIONS: dict[str, dict[str, Any]] = {
    "what": {
        "nargs": "*",
        "metavar": "SCENE|RUN",
        "help": "scenes by name or file, or exactly two runs: run folders, or ENGINE:SCENE for the newest run",
    },
    "name": {"metavar": "ENGINE", "help": "name of an engine, such as verlet or an entry of your engines.toml"},
    "scenes": {"nargs": "*", "metavar": "SCENE", "help": "scenes by name or file (default: the paper's four)"},
    "scenes (fit)": {
        "nargs": "*",
        "metavar": "SCENE",
        "help": "scenes with [[measured]] data (default: the scenes of --quoted)",
    },
    "--set": SEVERAL | {"metavar": "KEY=VALUE", "dest": "settings", "help": command_line.SET},
    "--unsafe": {
        "action": "store_true",
        "help": "accept a scene that a guard refuses, for instance a time step above the stability limit",
    },
    "--budget": {
        "type": command_line.seconds,
        "metavar": "SECONDS",
        "dest": "budget_s",
        "help": "engine time of all runs together (default: 300 s; 30 s with --quick)",
    },
    "--quick": {"action": "store_true", "help": "short study: fewer scenes, steps and seeds, no long runs"},
    "--quick (fit)": {"action": "store_true", "help": "fit alone: no profiles, no data left out, no runs of the codes"},
    "--studies": {
        "action": "store_true",
        "help": "write the page first, then run the studies and add them; short studies where no table exists",
    },
    "--free": SEVERAL
    | {
        "metavar": "KEY[=LOW..HIGH]",
        "help": "fit this key of the scene, such as contact.restitution=0.5..1; repeatable "
        "(default bounds: inputs/calibration.toml)",
    },
    "--own": SEVERAL
    | {"metavar": "KEY[=LOW..HIGH]", "help": "as --free, with a value of its own for each data set; repeatable"},
    "--quoted": {
        "type": _names,
        "default": (),
        "metavar": "SET,...",
        "help": "fit to data that the paper quotes: sets of inputs/calibration.toml, such as fig4,table1",
    },
    "--measured": {"type": Path, "metavar": "FILE", "help": command_line.MEASURED},
    "--engines": {"type": command_line.engines_file, "metavar": "FILE", "help": command_line.ENGINES_FILE},
    "--file": {"type": Path, "metavar": "FILE", "help": "file with the cases (default: inputs/independent.toml)"},
    "--out": {"type": Path, "metavar": "FILE", "help": "page to write (default: results/report.html)"},
    "--results": {"type": Path, "metavar": "DIR", "help": command_line.RESULTS},
    "--runs": {"type": Path, "metavar": "DIR", "help": command_line.RUNS},
    "--against": {
        "type": Path,
        "metavar": "DIR",
        "help": "compare the run folders in --runs with those in this folder, run by run",
    },
    "--engine": SEVERAL
    | {
        "metavar": "ENGINE",
        "help": "compare this engine with verlet and reference; repeatable (default: all installed ones)",
    },
    "--require": SEVERAL | {"metavar": "ENGINE", "help": "fail if this engine does not run; repeatable"},
    "--allow-missing": {
        "action": "store_true",
        "help": "accept that engines of --engine, all codes or runs of --against are missing",
    },
}
CHECKS = {
    "results": command_line.must_be_folder,
    "runs": command_line.must_be_folder,
    "out": command_line.must_be_file,
}


def main() -> int:
    """Runs the command line and returns its exit code."""
    arguments = _parser().parse_args()
    for option, check in CHECKS.items():
        if not (option == "runs" and getattr(arguments, "against", None)):  # only read
            check(f"--{option}", getattr(arguments, option, None))
    return int(arguments.action(arguments))


def _asked(arguments: argparse.Namespace) -> "EngineSelection":
    """Engines of the options ``--engine`` and ``--require``; InputError if one is unknown."""
    from drivers.engines import load_engine
    from validation.compare.selection import EngineSelection

    for option in ("engine", "require"):
        for name in getattr(arguments, option):
            load_engine(name, f"--{option}")
    return EngineSelection(tuple(arguments.engine), tuple(arguments.require), arguments.allow_missing)


def _compare(arguments: argparse.Namespace) -> int:
    asked, runs = _asked(arguments), arguments.runs or paths.RUNS
    folders = [what for what in arguments.what if Path(what).is_dir() or ":" in what]
    if folders:
        if len(folders) != 2 or len(arguments.what) != 2:
            raise InputError("compare", "", " ".join(arguments.what), "scenes, or exactly two runs")
        for option in ("settings", "engine", "require", "against"):
            if getattr(arguments, option):
                words = option.replace("settings", "set")
                raise InputError(f"--{words}", "", "not allowed with two runs")
        from drivers.inventory.run_folders import run_folder
        from validation.compare.pair import compare_runs

        return compare_runs(*(run_folder(folder, runs) for folder in folders))
    if arguments.against:
        if arguments.settings:
            raise InputError("--set", "", "not allowed with --against")
        from validation.compare.folders import compare_folders

        return compare_folders(runs, arguments.against, arguments.what, asked)
    if not arguments.what and not asked.builds:
        needed = "scenes, two runs, --against DIR, or --engine twice with builds of one code"
        raise InputError("compare", "", f"scene missing; give {needed}")
    from validation.compare.compare_command import compare_scenes

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
    from validation.calibration.fit_command import FitRequest, run_fit

    given = {field.name: getattr(arguments, field.name) for field in fields(FitRequest)}
    return run_fit(FitRequest(**given), arguments.runs or paths.RUNS, arguments.results or paths.RESULTS)


def _engine(arguments: argparse.Namespace) -> int:
    from validation.kit.judge import judge_engine

    return judge_engine(arguments.name, arguments.runs or paths.RUNS, arguments.results)


def _wave(_: argparse.Namespace) -> int:
    from validation.reference.travelling_wave import constants, solve_travelling_wave

    print("\n".join(constants(solve_travelling_wave())))
    return 0


@dataclass(frozen=True)
class Command:
    """A command: its function, one line of help, its options and example command lines, without the program."""

    action: Callable[[argparse.Namespace], int]
    summary: str
    options: tuple[str, ...]
    examples: tuple[str, ...] = ("",)


WHICH = ("--runs", "--engine", "--require", "--allow-missing")
QUICK = ("", "--quick")
COMMANDS = {
    "compare": Command(
        _compare,
        "run scenes and judge them on every engine, or compare runs",
        ("what", "--set", *WHICH, "--against", "--unsafe"),
        ("fig4", "fig4 --set run.time_step='1 us'", "yade:fig4 liggghts:fig4", "--runs old --against new"),
    ),
    "report": Command(
        _report,
        "write the report page and its checks as JSON",
        ("scenes", "--studies", "--out", *WHICH),
        ("", "fig4 --out fig4.html --allow-missing"),
    ),
    "claims": Command(_study, "compute and judge every quantitative statement of the paper", ("--results", "--runs")),
    "trade": Command(
        _study,
        "measure error against cost for all engines and time steps",
        ("--quick", "--budget", "--results"),
        ("--quick", "--budget 600"),
    ),
    "stability": Command(
        _study,
        "measure stable steps, extreme scenes, long runs, rounding",
        ("--quick", "--results", "--runs"),
        QUICK,
    ),
    "elements": Command(
        _study,
        "measure effect and cost of each modelling element",
        ("--quick", "--results", "--runs"),
        QUICK,
    ),
    "independent": Command(
        _study,
        "judge the engines by published numbers and theory",
        ("--file", "--results", "--runs"),
        ("", "--file my-cases.toml"),
    ),
    "calibration": Command(
        _study,
        "fit parameters of each contact law to the paper's experiments",
        ("--quick", "--results"),
        QUICK,
    ),
    "fit": Command(
        _fit,
        "fit parameters of scenes to measured data",
        ("scenes (fit)", "--free", "--own", "--measured", "--quoted", "--set", "--quick (fit)", "--results", "--runs"),
        (
            "example-measured --free contact.restitution",
            "--quoted fig4 --free contact.restitution=0.5..1",
        ),
    ),
    "engine": Command(
        _engine,
        "judge an adapter or a build of a code",
        ("name", "--results", "--runs"),
        ("verlet", "liggghts-old --engines mine.toml"),
    ),
    "wave": Command(_wave, "print constants of the discrete chain's solitary wave", ()),
}


def _parser() -> command_line.Parser:
    program = "python -m validation"
    summary = "compare runs with an independent reference and write the report"
    parser = command_line.Parser(
        prog=program, summary=summary, examples=(f"{program} compare fig4", f"{program} report"), version=True
    )
    add_command = parser.add_commands()
    for name, command in COMMANDS.items():
        examples = tuple(f"{program} {name} {example}".rstrip() for example in command.examples)
        adder = add_command(name, command.summary, examples)
        for option in (*command.options, *["--engines"] * bool(command.options)):
            adder.add_argument(option.split(" ")[0], **OPTIONS[option])
        adder.set_defaults(action=command.action)
    return parser


if __name__ == "__main__":
    command_line.run_main(main)
