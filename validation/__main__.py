"""``python -m validation``: compares runs and writes the report."""

import argparse
import sys
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.base.command_line import Parser, must_be_file, must_be_folder, run_main, seconds
from drivers.base.errors import InputError

if TYPE_CHECKING:
    from validation.compare.compared_scenes import ComparedScene
    from validation.compare.verdict import Verdict

# what each study is and its options beside --results; validation.studies has the rest
STUDIES = {
    "trade": ("errors against cost, for all engines and steps, and what to use", "--budget"),
    "stability": ("limits of the time step, extremes, long runs, rounding", "--quick", "--runs"),
    "elements": ("what each modelling element adds and costs, step by step", "--quick", "--runs"),
}
OPTIONS: dict[str, dict[str, Any]] = {
    "--budget": {
        "type": seconds,
        "metavar": "S",
        "dest": "budget_s",
        "help": "engine time of all runs (default: 300 s)",
    },
    "--quick": {"action": "store_true", "help": "the short study: fewer scenes and seeds, no long runs"},
    "--results": {"type": Path, "metavar": "DIR", "help": "default: results/"},
    "--runs": {"type": Path, "metavar": "DIR", "help": "where run folders are (default: runs/)"},
}


def main() -> int:
    """Reads the command line and does what it says."""
    arguments = _parser().parse_args()
    return int(arguments.action(arguments))


def _parser() -> Parser:
    parser = Parser(prog="python -m validation", description="How far runs are from an independent reference.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    compare = commands.add_parser("compare", help="verdicts on scenes, run where needed, or on two run folders")
    compare.add_argument("what", nargs="+", metavar="SCENE|RUN RUN", help="scene files or names; or two run folders")
    compare.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings")
    compare.add_argument("--runs", type=Path, metavar="DIR", help="where run folders are (default: runs/)")
    compare.add_argument("--unsafe", action="store_true", help="run what a guard refuses")
    compare.set_defaults(action=_compare)

    report = commands.add_parser("report", help="write the report page, and its verdicts for programs")
    report.add_argument("scenes", nargs="*", metavar="SCENE", help="default: the paper's four, fig4 to fig6d")
    report.add_argument("--out", type=Path, metavar="FILE", help="default: results/report.html; JSON and XML beside it")
    report.add_argument("--runs", type=Path, metavar="DIR", help="where run folders are (default: runs/)")
    report.set_defaults(action=_report)

    claims = commands.add_parser("claims", help="compute and judge every quantitative statement of the paper")
    claims.add_argument("--out", type=Path, metavar="FILE", help="default: results/claims.csv")
    claims.add_argument("--runs", type=Path, metavar="DIR", help="where run folders are (default: runs/)")
    claims.set_defaults(action=_claims)

    for name, (summary, *options) in STUDIES.items():
        study = commands.add_parser(name, help=summary)
        for option in (*options, "--results"):
            study.add_argument(option, **OPTIONS[option])
        study.set_defaults(action=_study, study=name)

    independent = commands.add_parser(
        "independent", help="cases beyond the paper, against published numbers and theory"
    )
    independent.add_argument("--file", type=Path, metavar="FILE", help="cases (default: inputs/independent.toml)")
    independent.add_argument("--results", type=Path, metavar="DIR", help="default: results/")
    independent.add_argument("--runs", type=Path, metavar="DIR", help="where run folders are (default: runs/)")
    independent.set_defaults(action=_independent)

    wave = commands.add_parser("wave", help="constants of the exact solitary wave of the discrete chain")
    wave.set_defaults(action=_wave)
    return parser


def _study(arguments: argparse.Namespace) -> int:
    from validation.studies import Options, load_study, run_study

    given = {key: value for key, value in vars(arguments).items() if value is not None}
    for option in ("results", "runs"):
        must_be_folder(f"--{option}", given.get(option))
    options = Options(**{field.name: given[field.name] for field in fields(Options) if field.name in given})
    return run_study(load_study(arguments.study), options)


def _independent(arguments: argparse.Namespace) -> int:
    from drivers.base import paths
    from validation.independent.independent_study import independent

    must_be_folder("--results", arguments.results)
    must_be_folder("--runs", arguments.runs)
    return independent(
        arguments.file or paths.INDEPENDENT, arguments.results or paths.RESULTS, arguments.runs or paths.RUNS
    )


def _wave(_: argparse.Namespace) -> int:
    from validation.reference.travelling_wave import solve_travelling_wave

    wave = solve_travelling_wave()
    print(f"speed c         = {wave.speed_by_force:.10f} k^(1/3) m^(-1/2) F_m^(1/6)   beads per second")
    print(f"                = {wave.speed_by_velocity:.10f} (k/m)^(2/5) v_m^(1/5)")
    print(f"force F_m       = {wave.force_by_velocity:.10f} k^(2/5) m^(3/5) v_m^(6/5)")
    print(f"momentum        = {wave.momentum_by_velocity:.10f} m v_m")
    print(f"energy          = {wave.energy_by_velocity:.10f} m v_m^2, of which kinetic {wave.kinetic_share:.10f}")
    for averaged, name in ((True, "sensor average"), (False, "contact force ")):
        widths = ", ".join(f"{wave.width(x, averaged=averaged):.6f} at {x:g}" for x in (0.002, 0.04, 0.5))
        print(f"width, {name}: {widths} of the peak (beads)")
    print(f"residual of the fixed point: {wave.residual:.1e}")
    return 0


def _claims(arguments: argparse.Namespace) -> int:
    from drivers.base import paths
    from drivers.engines import missing_codes
    from validation.claims.judged_claims import counted, judge_all, write_claims

    must_be_file("--out", arguments.out)
    must_be_folder("--runs", arguments.runs)
    out = arguments.out or paths.RESULTS / paths.CLAIMS_TABLE
    judged = judge_all(arguments.runs or paths.RUNS)
    write_claims(judged, out)
    for each in judged:
        if each.verdict == "differs":
            claim = each.claim
            print(f"{claim.id}: quoted {claim.quoted:g}, computed {each.value:.4g} {claim.unit}: {claim.explained}")
    print(f"{paths.shown(out)}: {counted(judged)}")
    if missing_codes():
        print(f"without what is not installed: {', '.join(missing_codes())}", file=sys.stderr)
    faults = [each for each in judged if each.fault]
    for each in faults:
        print(f"{each.claim.id}: {each.fault}", file=sys.stderr)
    return 1 if faults else 0


def _compare(arguments: argparse.Namespace) -> int:
    folders = [Path(what) for what in arguments.what if Path(what).is_dir()]
    if folders:
        if len(folders) != 2 or len(arguments.what) != 2:
            raise InputError("compare", "", " ".join(arguments.what), "scenes, or exactly two run folders")
        if arguments.settings:
            raise InputError("--set", "", "a setting for runs that are done", "settings of scenes")
        from validation.compare.compare_runs import compare_runs

        return compare_runs(*folders)
    from drivers.base import paths
    from validation.compare.compared_scenes import run_and_compare
    from validation.compare.verdict import FAIL

    failed = False
    for source in arguments.what:
        compared = run_and_compare(
            source, tuple(arguments.settings), arguments.runs or paths.RUNS, unsafe=arguments.unsafe
        )
        _print_table(compared.verdicts)
        _print_departures(compared)
        for engine, sentence in compared.diagnoses.items():
            print(f"{compared.case.scene.name:<12} {engine:<10} diagnosis: {sentence}")
        _print_budgets(compared)
        failed |= any(verdict.verdict == FAIL for verdict in compared.verdicts)
    return 1 if failed else 0


def _print_table(verdicts: "list[Verdict]") -> None:
    print(f"{'scene':<12} {'engine':<10} {'quantity':<24} {'error':>9} {'allowed':>9}  verdict")
    for v in verdicts:
        numbers = f"{v.value:9.2e} {v.limit:9.2e}" if v.quantity != "run" else " " * 19
        print(f"{v.scene:<12} {v.engine:<10} {v.quantity:<24} {numbers}  {v.verdict}: {v.where}")


def _print_departures(compared: "ComparedScene") -> None:
    """When each run first leaves the exact motion, and why."""
    from validation.compare.departure import departure_rows

    print()
    for row in departure_rows(compared.departures):
        print(f"{compared.case.scene.name:<12} {row.engine:<10} {row.words}")


def _print_budgets(compared: "ComparedScene") -> None:
    """The parts of each run's errors, as signed shares; they add up to the whole."""
    from validation.accuracy.budget import PARTS, for_terminal

    print(f"\n{'error budget':<23} {'quantity':<24} " + " ".join(f"{part:>10}" for part in PARTS))
    for engine, run in compared.runs.items():
        for quantity, numbers in for_terminal(run.record.error_budget or ()):
            print(f"{compared.case.scene.name:<12} {engine:<10} {quantity:<24} {numbers}")
        for warning in run.record.warnings or ():
            print(f"{compared.case.scene.name:<12} {engine:<10} warning: {warning}")
        if run.record.error_note:
            print(f"{compared.case.scene.name:<12} {engine:<10} {run.record.error_note}")


def _report(arguments: argparse.Namespace) -> int:
    from validation.report.write_report import report

    must_be_file("--out", arguments.out)
    must_be_folder("--runs", arguments.runs)
    return report(arguments.scenes, arguments.out, arguments.runs)


if __name__ == "__main__":
    run_main(main)
