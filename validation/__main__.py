# PYTHON_ARGCOMPLETE_OK
"""``python -m validation``: compares runs, measures errors and limits, and writes the report."""

import argparse
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

import drivers.environment  # noqa: F401 - checks the environment before further imports
from drivers.base import command_line, paths
from drivers.base.command_line import SEVERAL, Command, Options, argument, seconds
from drivers.base.errors import InputError, RunError

if TYPE_CHECKING:
    from validation.compare.selection import EngineSelection


def _names(text: str) -> tuple[str, ...]:
    """Reads names that are separated by commas."""
    return tuple(name.strip() for name in text.split(","))


OPTIONS: Options = {
    **argument(
        "what",
        "scenes by name or file, or exactly two runs: run folders, or ENGINE:SCENE for the newest run",
        "SCENE|RUN",
        nargs="*",
    ),
    **argument("name", "name of an engine, such as verlet or an entry of your engines.toml", "ENGINE"),
    **argument("scenes", "scenes by name or file (default: the paper's four)", "SCENE", nargs="*"),
    **argument("scenes (fit)", "scenes with [[measured]] data (default: the scenes of --quoted)", "SCENE", nargs="*"),
    **argument(
        "--budget",
        "engine time of all runs together (default: 300 s; 30 s with --quick)",
        "SECONDS",
        type=seconds,
        dest="budget_s",
    ),
    **argument("--quick", "short study: fewer scenes, steps and seeds, no long runs"),
    **argument("--quick (fit)", "fit alone: no profiles, no data left out, no runs of the codes"),
    **argument(
        "--studies", "write the page first, then run the studies and add them; short studies where no table exists"
    ),
    **argument(
        "--free",
        "fit this key of the scene, such as contact.restitution=0.5..1; repeatable "
        "(default bounds: inputs/calibration.toml)",
        "KEY[=LOW..HIGH]",
        **SEVERAL,
    ),
    **argument(
        "--own", "as --free, with a value of its own for each data set; repeatable", "KEY[=LOW..HIGH]", **SEVERAL
    ),
    **argument(
        "--quoted",
        "fit to data that the paper quotes: sets of inputs/calibration.toml, such as fig4,table1",
        "SET,...",
        type=_names,
        default=(),
    ),
    **argument("--file", "file with the cases (default: inputs/independent.toml)", "FILE", type=Path),
    **argument("--out", "page to write (default: results/report.html)", "FILE", type=Path),
    **argument(
        "--against", "compare the run folders in --runs with those in this folder, run by run", "DIR", type=Path
    ),
    **argument(
        "--engine",
        "compare this engine with verlet and reference; repeatable (default: all installed ones)",
        "ENGINE",
        **SEVERAL,
    ),
    **argument("--require", "fail if this engine does not run; repeatable", "ENGINE", **SEVERAL),
    **argument("--allow-missing", "accept that engines of --engine, all codes or runs of --against are missing"),
    **command_line.SETTINGS,
    **command_line.UNSAFE,
    **command_line.MEASURED,
    **command_line.ENGINES,
    **command_line.RESULTS,
    **command_line.RUNS,
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
    from validation.chapters import Options, load_chapter, run_chapter

    given = {key: value for key, value in vars(arguments).items() if value is not None}
    options = Options(**{field.name: given[field.name] for field in fields(Options) if field.name in given})
    return run_chapter(load_chapter(arguments.command), options)


def _fit(arguments: argparse.Namespace) -> int:
    from validation.calibration.fit_command import FitRequest, run_fit

    given = {field.name: getattr(arguments, field.name) for field in fields(FitRequest)}
    return run_fit(FitRequest(**given), arguments.runs or paths.RUNS, arguments.results or paths.RESULTS)


def _engine(arguments: argparse.Namespace) -> int:
    """Runs the tests of an engine and measures its cost; returns 1 if a test failed."""
    from drivers.engines import load_engine
    from validation.accuracy.costs import entry_of, measured_cost

    engine = load_engine(arguments.name)
    if engine.find() is None:
        raise RunError(f"{arguments.name}: {engine.absence}")
    try:
        import pytest
    except ImportError as error:
        raise RunError(f"pytest is not installed; make engine ENGINE={arguments.name} installs it") from error
    words = ["-v", "-rs", "--tb=short", "--rootdir", str(paths.ROOT), "-c", str(paths.ROOT / "pyproject.toml")]
    if arguments.results:
        words += ["--junitxml", str(arguments.results / f"engine-{arguments.name}.xml")]
    failed = int(pytest.main([*words, "--engine", arguments.name, str(paths.ROOT / "validation/tests/engine")]) != 0)
    cost = measured_cost(engine)
    where = f"as an entry of {paths.shown(paths.COSTS)}; for own engines no file has to be edited"
    print(f"\nmeasured cost, cached for plans and batches ({where}):\n" + "\n".join(entry_of(arguments.name, cost)))
    return failed


def _wave(_: argparse.Namespace) -> int:
    from validation.reference.travelling_wave import constants, solve_travelling_wave

    print("\n".join(constants(solve_travelling_wave())))
    return 0


def _options(*names: str) -> Options:
    """Options by name, with ``--engines``; words in brackets distinguish options of one name."""
    return {name.split(" ")[0]: OPTIONS[name] for name in (*names, "--engines")}


WHICH = ("--runs", "--engine", "--require", "--allow-missing")
QUICK = ("", "--quick")
COMMANDS = {
    "compare": Command(
        _compare,
        "run scenes and judge them on every engine, or compare runs",
        _options("what", "--set", *WHICH, "--against", "--unsafe"),
        ("fig4", "fig4 --set run.time_step='1 us'", "yade:fig4 liggghts:fig4", "--runs old --against new"),
    ),
    "report": Command(
        _report,
        "write the report page and its checks as JSON",
        _options("scenes", "--studies", "--out", *WHICH),
        ("", "fig4 --out fig4.html --allow-missing"),
    ),
    "claims": Command(
        _study, "compute and judge every quantitative statement of the paper", _options("--results", "--runs")
    ),
    "trade": Command(
        _study,
        "measure error against cost for all engines and time steps",
        _options("--quick", "--budget", "--results"),
        ("--quick", "--budget 600"),
    ),
    "stability": Command(
        _study,
        "measure stable steps, extreme scenes, long runs, rounding",
        _options("--quick", "--results", "--runs"),
        QUICK,
    ),
    "elements": Command(
        _study,
        "measure effect and cost of each modelling element",
        _options("--quick", "--results", "--runs"),
        QUICK,
    ),
    "independent": Command(
        _study,
        "judge the engines by published numbers and theory",
        _options("--file", "--results", "--runs"),
        ("", "--file my-cases.toml"),
    ),
    "calibration": Command(
        _study,
        "fit parameters of each contact law to the paper's experiments",
        _options("--quick", "--results"),
        QUICK,
    ),
    "fit": Command(
        _fit,
        "fit parameters of scenes to measured data",
        _options(
            "scenes (fit)", "--free", "--own", "--measured", "--quoted", "--set", "--quick (fit)", "--results", "--runs"
        ),
        (
            "example-measured --free contact.restitution",
            "--quoted fig4 --free contact.restitution=0.5..1",
        ),
    ),
    "engine": Command(
        _engine,
        "test an adapter or a build of a code",
        _options("name", "--results"),
        ("verlet", "liggghts-old --engines mine.toml"),
    ),
    "wave": Command(_wave, "print constants of the discrete chain's solitary wave", {}),
}


def _parser() -> command_line.Parser:
    summary = "compare runs with an independent reference and write the report"
    return command_line.build_parser("python -m validation", summary, ["compare fig4", "report"], COMMANDS)


if __name__ == "__main__":
    command_line.run_main(main)
