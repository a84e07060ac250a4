"""``python -m validation compare --runs OLD --against NEW``: quantities in which runs of the same scenes differ."""

import shlex
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from drivers.base import paths
from drivers.base.command_line import engines_again
from drivers.base.errors import InputError
from drivers.inventory.run_folders import KeptRun, kept_runs
from validation.compare.asked import Asked, print_unmet
from validation.compare.pair import LEVELS, compare_pair, different_keys, open_pair
from validation.compare.verdict import FAIL, NOT_RUN, RUN, Verdict, heading, line_of, without_run

ROUNDING = min(LEVELS)  # of the largest change: what differs by less has not moved
ALL = "all"  # quantities, where none has moved
Key = tuple[str, str]


def moved(first: Path, second: Path) -> list[Verdict]:
    """Verdicts on the quantities in which two finished runs differ by more than rounding, and when they part.

    Where none does there is one verdict, on the largest difference; where they cannot be compared, one that fails.
    """
    try:
        pair = compare_pair(*open_pair(first, second))
    except InputError as error:
        return [without_run("", "", str(error), FAIL)]
    until = f"; {pair.until}" if pair.until else ""
    if found := [verdict for verdict in pair.verdicts if not verdict.value <= ROUNDING]:
        parted = pair.parted[ROUNDING]
        since = f"they part at {parted.time_s * 1e6:.6g} µs in {parted.quantity}" if parted else "no force parts"
        return [replace(verdict, where=f"{verdict.where}; {since}{until}") for verdict in found]
    most = max(pair.verdicts, key=lambda verdict: verdict.value)
    words = f"the same to rounding, most of all {most.quantity}" if most.value else "the same, bit for bit"
    return [replace(most, quantity=ALL, where=words + until)]


def compare_folders(old: Path, new: Path, scenes: Sequence[str], asked: Asked) -> int:
    """Prints in which quantities the runs of two folders differ, each from the one of its engine, scene and settings.

    The exit code is 1 if a quantity differs by more than is allowed, if a run failed or cannot be read, if one is
    missing on one side and may not be, or if an engine that is required has no pair.

    Raises:
        InputError: a folder has no runs, or neither has one of a scene.
    """
    if old.resolve() == new.resolve():
        raise InputError("--against", "", f"the folder of --runs, {paths.shown(new)}", "another folder of runs")
    found = _runs("--runs", old), _runs("--against", new)
    names, known = {Path(scene).stem for scene in scenes}, {run.scene for side in found for run in side.values()}
    for name in sorted(names - known):
        raise InputError("compare", "", f'no run of "{name}" in either folder', ", ".join(sorted(known)))
    wanted = {*asked.engines, *asked.require} if asked.engines else {engine for side in found for engine, _ in side}
    first, second = (
        {key: run for key, run in side.items() if run.engine in wanted and (not names or run.scene in names)}
        for side in found
    )
    either = second | first
    for engine in sorted({engine for engine, _ in either}):
        of_engine = ({run.build for run in side.values() if run.engine == engine} for side in (first, second))
        one, other = (" and ".join(sorted(builds)) or "no run" for builds in of_engine)
        print(f"{engine:<10} {one} {'on both sides' if one == other else f'against {other}'}")
    print(f"\n{heading()}")
    compared, failed, again = 0, 0, []
    alike = Counter((run.scene, run.engine) for run in either.values())
    for key, run in sorted(either.items(), key=lambda item: (item[1].scene, item[0])):
        if key in first and key in second and not (first[key].trouble or second[key].trouble):
            rows = moved(first[key].folder, second[key].folder)
        else:
            rows = [_unpaired(key, {old: first, new: second}, asked)]
        name = run.scene if alike[run.scene, run.engine] == 1 else run.folder.name  # there are other settings
        for verdict in rows:
            print(line_of(replace(verdict, scene=name, engine=run.engine)), flush=True)
        compared += rows[0].quantity != RUN
        if any(verdict.verdict == FAIL for verdict in rows):
            failed += 1
            again += [(first[key].folder, second[key].folder)] if rows[0].quantity != RUN else []
    print(f"\n{len(either)} runs: {compared} compared, {failed} failed, missing or moved beyond what is allowed")
    print_again(again)
    return 1 if print_unmet(asked.unmet(engine for engine, _ in first.keys() & second.keys())) or failed else 0


def print_again(pairs: Iterable[tuple[Path, Path]]) -> None:
    """Prints the commands that show more of pairs of runs."""
    for pair in pairs:
        words = ["python", "-m", "validation", "compare", *map(paths.shown, pair), *engines_again()]
        print("look closer:", shlex.join(words))


def _runs(option: str, folder: Path) -> dict[Key, KeptRun]:
    """Runs of a folder; of those of several builds of an engine the last, not one beside which a better one stands."""
    found = kept_runs(folder)
    if not found:
        allowed = "a folder of runs, as python -m drivers run --runs writes them"
        raise InputError(f"{option} {paths.shown(folder)}", "", "no run", allowed)
    return {run.key: run for run in sorted(found, key=lambda run: not run.folder.name.endswith("-failed"))}


def _unpaired(key: Key, sides: dict[Path, dict[Key, KeptRun]], asked: Asked) -> Verdict:
    """The verdict on a run that failed, or is missing in one of the folders."""
    troubles, missing = [], []
    for folder, side in sides.items():
        if key in side and side[key].trouble:
            troubles.append(f"{side[key].trouble} (in {paths.shown(folder)})")
        elif key not in side:
            missing.append(f"no such run in {paths.shown(folder)}{_closest(key, side, sides)}")
    return without_run("", "", "; ".join(troubles + missing), FAIL if troubles or not asked.allow_missing else NOT_RUN)


def _closest(key: Key, side: dict[Key, KeptRun], sides: dict[Path, dict[Key, KeptRun]]) -> str:
    """Keys in which the closest run of a scene differs from one that is missing, in words."""
    (own,) = (other[key] for other in sides.values() if key in other)
    alike = [run.record for run in side.values() if (run.engine, run.scene) == (own.engine, own.scene) and run.record]
    if own.record is None or not alike:
        return ""
    closest: list[str] = min((different_keys(own.record.scene, record.scene) for record in alike), key=len)
    return f"; the closest differs: {'; '.join(closest)}"
