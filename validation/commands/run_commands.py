"""Commands that plan, run, judge and read scenes and their runs, without figures."""

import json
import sys
from dataclasses import replace
from functools import partial
from math import isnan
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.terminal import counted, text_table
from drivers.chain.case import Case, build_case
from drivers.chain.trace import FORCE
from drivers.engines import engine_names, expected_engines, installed, load_engine
from drivers.engines._raw_output import files_of
from drivers.limits import inability, refuse
from drivers.run import inventory
from drivers.run.run import import_run, is_done, run_case
from drivers.run.run_folder import EndedRun, open_run, scene_of, write_scene
from drivers.run.scheme import scheme_of
from postproc.read.motion import trace_with_state
from postproc.read.observables import LEVELS, observe, without_unit
from validation.accuracy.budget import MODEL, assess, kept_budget, missed_accuracy
from validation.accuracy.costs import auto_engines, capable_engines
from validation.accuracy.plan import plan_report, planned_case
from validation.compare.comparison import EngineSelection, compare_runs, compare_scenes
from validation.compare.diagnosis import diagnosis

Words = tuple[str, ...]
AUTO = "auto"  # instead of an engine's name: the cheapest engine that can model the scene


def plan(scene: str, settings: Words, engines: Words) -> None:
    """Print time step, expected errors and cost of a scene.

    Examples:
      beads plan fig4
      beads plan fig4 --set run.time_step= --set run.accuracy=1e-4
    """
    for name in engines:
        load_engine(name, "--engine")
    for line in plan_report(scene, settings, engines):
        print(line)


def run(
    scene: str, settings: Words, engines: Words, runs: Path, rerun: bool, unsafe: bool, time_limit: float | None = None
) -> int:
    """Run a scene and print the run folders.

    --engine auto takes the cheapest engine that models the scene, after those whose build or run failed the next
    one.

    Examples:
      beads run fig4 --engine yade
      beads run fig4 --engine auto
      beads run fig4 --set chain.count=60 --set run.time_step='50 ns'
    """
    auto = engines == (AUTO,)
    for name in () if auto else engines:
        load_engine(name, "--engine", also=(f"{AUTO} alone",))  # refuses a wrong name before the case is planned
    case = planned_case(scene, *settings)
    once = partial(_ran, case, runs=runs, rerun=rerun, limit_s=time_limit)
    for name in auto_engines(case, None if rerun else runs) if auto else ():
        if not unsafe:
            refuse(case, name)
        if once(name, left_out="; --engine auto leaves it out"):
            return 0
    here = installed(engine_names())
    names = list(dict.fromkeys(engines)) or capable_engines(case, here)
    for name in names:
        if cannot := inability(case, name):
            raise cannot
        if not unsafe and (rerun or not is_done(case, name, runs)):
            refuse(case, name)  # before any engine starts
    done = [once(name) for name in names]
    for name in [] if engines else expected_engines():
        if why := "not installed" if name not in here else inability(case, name):
            print(f"not run on {name}: {why}", file=sys.stderr)
    return int(not all(done))


def _ran(case: Case, name: str, runs: Path, rerun: bool, limit_s: float | None, left_out: str = "") -> bool:
    """Run a case on an engine and show the run; returns False if it fails or misses its accuracy."""
    try:
        with counted(f"running {case.scene.name} on {name}"):
            ended = run_case(case, name, runs, rerun=rerun, limit_s=limit_s)
        with counted(f"measuring the error of {case.scene.name} on {name}"):
            return show_run(assess(ended, case, limit_s), left_out)
    except (RunError, OSError) as error:
        print(f"{case.scene.name}: {name}: {error}{left_out}", file=sys.stderr)
        return False


def show_run(ended: EndedRun, left_out: str = "") -> bool:
    """Print the folder and the warnings of a run, and why it failed or missed its accuracy; returns False if so.

    With words on why a wrong run is left out, its folder is no result.
    """
    name = f"{ended.record.scene_name}: {ended.record.engine}"
    for warning in ended.record.warnings or ():
        print(f"{name} warning: {warning}", file=sys.stderr)
    missed = missed_accuracy(ended) if ended.done else ""
    wrong = f"missed the accuracy: {missed}" if missed else ended.trouble
    if not (wrong and left_out):
        print(paths.shown(ended.folder), flush=True)
    if wrong:
        print(f"{name} {wrong}{left_out}", file=sys.stderr)
    return not wrong


def compare(
    what: Words, settings: Words, engines: Words, runs: Path, require: Words, allow_missing: bool, unsafe: bool
) -> int:
    """Run scenes and judge them on every engine, or compare runs.

    Examples:
      beads compare fig4
      beads compare fig4 --set run.time_step='1 us'
      beads compare yade:fig4 liggghts:fig4
    """
    folders = [source for source in what if Path(source).is_dir() or ":" in source]
    if not folders:
        return compare_scenes(what, settings, runs, EngineSelection(engines, require, allow_missing), unsafe=unsafe)
    if len(folders) != 2 or len(what) != 2:
        raise InputError("compare", "", " ".join(what), "scenes, or exactly two runs")
    for option, given in (("--set", settings), ("--engine", engines), ("--require", require)):
        if given:
            raise InputError(option, "", "not allowed with two runs")
    return compare_runs(*(inventory.run_folder(folder, runs) for folder in folders))


def render(scene: str, settings: Words, engine: str, deck: Path, unsafe: bool) -> None:
    """Write the deck of a scene for one engine, without running it.

    Example:
      beads render fig4 --engine liggghts --out deck
    """
    code = load_engine(engine, "--engine")
    case = planned_case(scene, *settings)
    if not unsafe:
        refuse(case, engine)
    rendered = code.by_hand(code.render(case))
    deck.mkdir(parents=True, exist_ok=True)
    write_scene(deck, case.scene)
    for file in rendered.write(deck):
        print(file)


def import_(
    *, folder: Path | None = None, dump: Path | None = None, columns: str, rendered: str, settings: Words, engine: str,
    runs: Path,
) -> int:  # fmt: skip
    """Make a run folder of a deck that was run by hand.

    The deck may have been changed: the record names each line that differs from the scene's deck. With --dump it may
    be one of your own.

    Examples:
      beads import deck --engine liggghts
      beads import deck --engine yade --set run.time_step='0.2 us'
      beads import --dump shot.txt --engine liggghts --scene fig4
      beads import --dump a.bin --columns id,z,vz,fz --engine lammps --scene fig4
    """
    load_engine(engine, "--engine")
    if folder and dump and files_of(folder / dump):
        dump = folder / dump
    if dump and not files_of(dump):
        raise InputError("--dump", "", f"{dump}, which is no file", "the dump of a run")
    place = folder or (dump and dump.parent)
    if place is None:
        raise InputError("import", "", "no folder; give that of the deck, or --dump FILE")
    case = planned_case(rendered, *settings) if rendered else build_case(scene_of(place, settings))
    ended = import_run(place, case, engine, runs, dump, tuple(map(str.strip, columns.split(",") if columns else ())))
    case = replace(case, digits=ended.record.digits)
    ended = assess(ended, case)
    print(*(f"deck changed: {edit}" for edit in ended.record.edits or ["nothing"]), sep="\n", file=sys.stderr)
    shown = show_run(ended)
    if shown:
        departure, cause = diagnosis(case, engine, trace_with_state(ended))
        (check,) = (each for each in kept_budget(case, ended).checks if each.quantity == f"{MODEL}: {FORCE}")
        until = scheme_of(case, engine).until_horizon
        agrees = f"the forces are those of its scheme to {check.value:.1e} of their largest change{until}"
        print(cause if departure else agrees, file=sys.stderr)
    return int(not shown)


def runs(scenes: Words, settings: Words, engines: Words, runs_read: Path, prune: bool, dry_run: bool) -> None:
    """List the run folders, or remove those that are obsolete.

    Examples:
      beads runs fig4 --engine yade
      beads runs --set 'striker.speed=*'
      beads runs --prune --dry-run
    """
    if runs_read != paths.RUNS and not runs_read.is_dir():
        raise InputError(f"--runs {runs_read}", "", "folder not found")
    if prune:
        inventory.prune(runs_read, scenes, engines, settings, dry_run=dry_run)
    else:
        inventory.print_runs(runs_read, scenes, engines, settings)


def observables(run: str, runs_read: Path, levels: tuple[float, ...], as_json: bool) -> None:
    """Print peaks, speeds, widths, reflections, energies of a run.

    Examples:
      beads observables yade:fig4
      beads observables yade:fig4 --level 0.1 --json
    """
    opened, _, _ = open_shown("observables", run, runs_read)
    observed = observe(opened.layout, opened.trace, levels or LEVELS)
    values = {name: None if isnan(value) else value for name, value in observed.items()}
    if as_json:
        print(json.dumps(values, indent=2))
        return
    errors = {part["quantity"]: f"{abs(part['whole']):.1e}" for part in opened.record.error_budget or ()}
    shown = {name: "not seen" if value is None else f"{value:.6g}" for name, value in values.items()}
    rows = [(name, value, errors.get(without_unit(name), "")) for name, value in shown.items()]
    print(*text_table([("observable", "value", "relative error"), *rows]), sep="\n")


def open_shown(what: str, run: str, runs: Path) -> tuple[EndedRun, str, str]:
    """A run, a name for the files that a command makes from it, and a title."""
    opened = open_run(inventory.run_folder(run, runs), failed=True)
    if not opened.done:
        end_s, reason = opened.trace.time_s[-1], opened.record.reason
        print(f"{run}: {opened.record.status}, shown until {end_s:g} s: {reason}", file=sys.stderr)
    name = f"{what}-{opened.record.engine}-{opened.folder.resolve().name}"
    return opened, name, f"{opened.record.scene.get('title') or opened.record.scene_name} ({opened.record.engine})"
