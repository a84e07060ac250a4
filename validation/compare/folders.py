"""``beads compare --runs OLD --against NEW``: quantities that differ between runs of the same scenes."""

import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.progress import following
from drivers.base.text_table import text_table
from drivers.engines._entries import engines_again
from drivers.inventory.run_folders import kept_runs, key_of
from drivers.run.run_folder import EndedRun
from validation.checks import FAIL, NOT_RUN, RUN, Check, table, without_run
from validation.compare.pair import LEVELS, compare_pair, different_keys, open_pair
from validation.compare.selection import EngineSelection, print_unmet

ROUNDING = min(LEVELS)  # of the largest change: smaller differences are not reported
ALL_QUANTITIES = "all"  # quantity of the row of a pair that agrees in all quantities
Key = tuple[str, str]


def moved(first: Path, second: Path, scene: str, engine: str) -> list[Check]:
    """Checks of the quantities that differ by more than rounding between two finished runs, named as given.

    If none does, one check of the largest difference; if the runs cannot be compared, one failure.
    """
    try:
        pair = compare_pair(*open_pair(first, second))
    except InputError as error:
        return [without_run(scene, engine, str(error), FAIL)]
    checks = [replace(check, scene=scene, engine=engine) for check in pair.checks]
    if different := [check for check in checks if not check.value <= ROUNDING]:
        place = pair.parted[ROUNDING]
        since = f"forces differ first in {place}" if place else "all forces agree"
        return [replace(check, where=f"{check.where}; {since}{pair.until}") for check in different]
    most = max(checks, key=lambda check: check.value)
    agreement = f"equal to rounding, largest difference in {most.quantity}" if most.value else "identical bit for bit"
    return [replace(most, quantity=ALL_QUANTITIES, where=agreement + pair.until)]


def compare_folders(old: Path, new: Path, scenes: Sequence[str], asked: EngineSelection) -> int:
    """Prints the quantities that differ between the runs of two folders, paired by engine, scene and settings.

    The exit code is 1 if a quantity differs by more than allowed, if a run failed or cannot be read, if a run is
    missing on one side (unless allowed), or if a required engine has no pair.

    Raises:
        InputError: a folder has no runs, or neither folder has a run of a scene.
    """
    if old.resolve() == new.resolve():
        raise InputError("--against", "", f"{paths.shown(new)} is the folder of --runs as well; name another folder")
    sides = _runs("--runs", old), _runs("--against", new)
    names = {Path(scene).stem for scene in scenes}
    known = {run.record.scene_name for side in sides for run in side.values()}
    for name in sorted(names - known):
        raise InputError("compare", "", f'"{name}" has no run in either folder; allowed: {", ".join(sorted(known))}')
    wanted = {*asked.engines, *asked.require} if asked.engines else {engine for side in sides for engine, _ in side}

    def is_wanted(run: EndedRun) -> bool:
        return run.record.engine in wanted and (not names or run.record.scene_name in names)

    first, second = ({key: run for key, run in side.items() if is_wanted(run)} for side in sides)
    either = second | first
    builds: list[tuple[str, str]] = []
    for engine in sorted({engine for engine, _ in either}):
        of_engine = ({_build(run) for run in side.values() if run.record.engine == engine} for side in (first, second))
        one, other = (" and ".join(sorted(builds)) or "no run" for builds in of_engine)
        builds.append((engine, f"{one} {'on both sides' if one == other else f'against {other}'}"))
    print(*text_table(builds), sep="\n")
    compared, failed, again = 0, 0, []
    alike = Counter(run.name for run in either.values())
    labels = {  # with other settings, a scene and engine have several runs
        key: run.record.scene_name if alike[run.name] == 1 else run.folder.name for key, run in either.items()
    }
    checks: list[Check] = []
    in_order = sorted(either.items(), key=lambda item: (item[1].record.scene_name, item[0]))
    for key, run in following(in_order, "compared", len(in_order), "pair"):
        if key in first and key in second and not (first[key].trouble or second[key].trouble):
            rows = moved(first[key].folder, second[key].folder, labels[key], run.record.engine)
        else:
            why, verdict = _unpaired(key, {old: first, new: second}, asked)
            rows = [without_run(labels[key], run.record.engine, why, verdict)]
        checks += rows
        compared += rows[0].quantity != RUN
        if any(check.verdict == FAIL for check in rows):
            failed += 1
            again += [(first[key].folder, second[key].folder)] if rows[0].quantity != RUN else []
    print("", *table(checks), sep="\n")
    print(f"\n{len(either)} runs: {compared} compared, {failed} failed, missing or changed by more than allowed")
    for pair in again:
        print("details:", shlex.join(["beads", "compare", *map(paths.shown, pair), *engines_again()]))
    return 1 if print_unmet(asked.unmet(engine for engine, _ in first.keys() & second.keys())) or failed else 0


def _runs(option: str, folder: Path) -> dict[Key, EndedRun]:
    """Runs of a folder by key; of several builds of an engine the last, failed runs only if there is no other."""
    kept = kept_runs(folder)
    if not kept:
        raise InputError(f"{option} {paths.shown(folder)}", "", "no runs here; beads run --runs writes them")
    return {key_of(run): run for run in sorted(kept, key=lambda run: not run.folder.name.endswith("-failed"))}


def _build(run: EndedRun) -> str:
    """Version line and digest of the build of a run."""
    return f"{run.record.engine_version} {run.record.build_sha256[:12]}".strip()


def _unpaired(key: Key, sides: dict[Path, dict[Key, EndedRun]], asked: EngineSelection) -> tuple[str, str]:
    """Reason why a run has no pair, and the verdict: it failed or is missing in one of the folders."""
    troubles, missing = [], []
    for folder, side in sides.items():
        if key in side and side[key].trouble:
            troubles.append(f"{side[key].trouble} (in {paths.shown(folder)})")
        elif key not in side:
            missing.append(f"no such run in {paths.shown(folder)}{_closest(key, side, sides)}")
    return "; ".join(troubles + missing), FAIL if troubles or not asked.allow_missing else NOT_RUN


def _closest(key: Key, side: dict[Key, EndedRun], sides: dict[Path, dict[Key, EndedRun]]) -> str:
    """Text on the keys in which the closest run of the scene differs from the missing run."""
    (known,) = (other[key] for other in sides.values() if key in other)
    alike = [run.record for run in side.values() if run.name == known.name and run.resolved]
    if not known.resolved or not alike:
        return ""
    closest: list[str] = min((different_keys(known.record.scene, record.scene) for record in alike), key=len)
    return f"; the closest differs: {'; '.join(closest)}"
