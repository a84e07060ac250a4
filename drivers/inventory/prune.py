"""Removal of runs that no command would use again, with reasons."""

import os
import shutil
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.processes import UNKNOWN_VERSION
from drivers.engines import engine_names, load_engine
from drivers.inventory.run_folders import UNREADABLE, batches_text, kept_runs, key_of, select, size_below, size_text
from drivers.run.build import Build, build_of
from drivers.run.run import run_identity
from drivers.run.run_folder import DAMAGED, FOLDER_NAME, EndedRun
from drivers.run.workplaces import leftovers, workplace

RECENT_S = 600.0  # a command may still read a run that is not older

UNREADABLE_RECORD = f"{UNREADABLE}; no command uses them"
FAILED_RUN = "failed or without forces; commands run them again"
OTHER_BUILD = "run by another build than the installed one, which would run them again"
OLDER_DECK = "run with an older deck; a newer run of the same scene, settings and engine exists"
REASONS_TO_REMOVE = (UNREADABLE_RECORD, FAILED_RUN, OTHER_BUILD, OLDER_DECK)

USED_RUN = "commands find them again"
RECENT_RUN = f"ended less than {RECENT_S / 60:g} minutes ago; a command may still read them"
UNKNOWN_ENGINE = "their engine has no entry here; --engines FILE names the file with its entry"
ABSENT_ENGINE = "their engine is not installed, or does not say its version, so its build is unknown"
RENAMED_FOLDER = "their folders have been renamed or are links"
IMPORTED = "imported, so no command makes them again"
REASONS_TO_KEEP = (USED_RUN, RECENT_RUN, UNKNOWN_ENGINE, ABSENT_ENGINE, RENAMED_FOLDER, IMPORTED)


def prune(
    runs: Path, scenes: Sequence[str], engines: Sequence[str], settings: Sequence[str], *, dry_run: bool = False
) -> None:
    """Remove runs that no command would use again, from a selection, and print which runs go and stay, with reasons.

    With ``dry_run`` nothing is removed, and the runs to be removed are listed.
    """
    kept = kept_runs(runs)
    homes = [runs / engine for engine in engines] or [*runs.glob("[!.]*/")]
    left = [] if scenes or settings else [folder for home in homes for folder in leftovers(home)]
    left_bytes = sum(map(size_below, left))
    reasons = _reasons(kept)
    selected = select(kept, scenes, engines, settings)
    removed = "would remove" if dry_run else "removed"
    freed = left_bytes
    for reason in REASONS_TO_REMOVE:
        group = [run for run in selected if reasons[run.folder] == reason]
        if not dry_run:
            group = _remove(group)
        freed += _print_group(removed, group, reason)
        for run in group if dry_run else ():
            print(f"    {paths.shown(run.folder)}")
    for reason in REASONS_TO_KEEP:
        _print_group("kept", [run for run in selected if reasons[run.folder] == reason], reason)
    if left:
        print(f"{removed} {len(left)} folder{'s' * (len(left) != 1)} of killed processes, {size_text(left_bytes)}")
    for folder in left:
        if dry_run:
            print(f"    {paths.shown(folder)}")
        else:
            shutil.rmtree(folder, ignore_errors=True)
    if (batches := batches_text(runs)) and not (scenes or engines or settings):
        print(f"kept {batches}; batches use those of unchanged decks and builds; remove the folder to free the space")
    print(f"{'would free' if dry_run else 'freed'} {size_text(freed)}")


def _print_group(done: str, group: Sequence[EndedRun], reason: str) -> int:
    """Print the line of a group of runs, if there are any, and return their size in bytes."""
    size = sum(run.size for run in group)
    if group:
        counts = sorted(Counter(run.record.engine for run in group).items())
        by_engine = ", ".join(f"{name} {count}" for name, count in counts)
        print(f"{done} {len(group)} run{'s' * (len(group) != 1)} ({by_engine}), {size_text(size)}: {reason}")
    return size


def _reasons(kept: Sequence[EndedRun]) -> dict[Path, str]:
    """Reason to remove or keep each run."""
    builds = {engine: _present_build(engine) for engine in {run.record.engine for run in kept}}
    reasons = {run.folder: _reason(run, builds[run.record.engine]) for run in kept}
    used = [run for run in kept if reasons[run.folder] == USED_RUN]
    decks = {key_of(run): run.record.deck_sha256 for run in used}  # the newest is last
    former = {run.folder: OLDER_DECK for run in used if run.record.deck_sha256 != decks[key_of(run)]}
    return reasons | former


def _reason(run: EndedRun, build: Build | str) -> str:
    if run.folder.is_symlink() or not FOLDER_NAME.fullmatch(run.folder.name):
        return RENAMED_FOLDER
    if time.time() - max((stat.st_mtime for stat in run.stats.values()), default=0.0) < RECENT_S:
        return RECENT_RUN
    if run.record.status == DAMAGED:
        return UNREADABLE_RECORD
    if run.record.edits is not None:
        return IMPORTED
    if run.trouble:
        return FAILED_RUN
    if isinstance(build, str):
        return build
    present = run_identity(run.record.engine, build, run.record.deck_sha256)
    return USED_RUN if run.record.identity == present else OTHER_BUILD


def _present_build(engine: str) -> Build | str:
    """Installed build of an engine, or the reason to keep its runs."""
    with suppress(InputError, RunError):
        build = build_of(load_engine(engine))
        if build.version != UNKNOWN_VERSION:
            return build
    return ABSENT_ENGINE if engine in engine_names() else UNKNOWN_ENGINE


def _remove(group: Sequence[EndedRun]) -> list[EndedRun]:
    """Remove runs, except those replaced by another process meanwhile; return the removed runs."""
    gone = []
    for home in {run.folder.parent for run in group}:
        if not os.access(home, os.W_OK):
            raise InputError(paths.shown(home), "", "a read-only folder", "one that can be written to")
        with workplace(home) as place:  # moved here first: the workplace is removed in any case
            for run in group:
                away = place / run.folder.name
                if run.folder.parent == home:
                    with suppress(FileNotFoundError):
                        run.folder.rename(away)
                        if EndedRun(away, run.record).ended == run.ended:
                            gone.append(run)
                        else:
                            away.rename(run.folder)
    return gone
