"""Removal of runs that no command would use again, with reasons."""

import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.processes import UNKNOWN_VERSION
from drivers.batch.store import WORK, Store
from drivers.engines import load_engine
from drivers.inventory.run_folders import (
    UNREADABLE,
    KeptRun,
    batches_text,
    kept_runs,
    select,
    size_below,
    size_text,
)
from drivers.run.build import Build, build_of
from drivers.run.run import run_identity
from drivers.run.run_folder import FOLDER_NAME, read_record
from drivers.run.workplaces import leased, leftovers, workplace

RECENT_S = 600.0  # a command may still read a run that is not older
REASONS_TO_REMOVE = {
    "unread": f"{UNREADABLE}; no command uses them",
    "failed": "failed or without forces; commands run them again",
    "build": "run by another build than the installed one, which would run them again",
    "deck": "run with an older deck; a newer run of the same scene, settings and engine exists",
}
REASONS_TO_KEEP = {
    "used": "commands find them again",
    "recent": f"ended less than {RECENT_S / 60:g} minutes ago; a command may still read them",
    "absent": "their engine is not installed, so its build is unknown",
    "named": "their folders have been renamed",
}


def prune(
    runs: Path, scenes: Sequence[str], engines: Sequence[str], settings: Sequence[str], *, dry_run: bool = False
) -> None:
    """Remove runs that no command would use again, from a selection, and print which runs go and stay, with reasons.

    With ``dry_run`` nothing is removed, and the runs to be removed are listed.
    """
    kept = kept_runs(runs)
    homes = [] if scenes or settings else [runs / engine for engine in engines] or _homes(runs)
    left = [folder for home in homes for folder in leftovers(home)]
    left_bytes = sum(map(size_below, left))
    reasons = _reasons(kept)
    groups: dict[str, list[KeptRun]] = {why: [] for why in (*REASONS_TO_REMOVE, *REASONS_TO_KEEP)}
    for run in select(kept, scenes, engines, settings):
        groups[reasons[run.folder]].append(run)
    freed = 0
    for why, words in (REASONS_TO_REMOVE | REASONS_TO_KEEP).items():
        group = groups[why]
        if why in REASONS_TO_REMOVE and not dry_run:
            group = _remove(group)
        if group:
            counts = sorted(Counter(run.engine for run in group).items())
            by_engine = ", ".join(f"{name} {count}" for name, count in counts)
            size = sum(run.size for run in group)
            freed += size if why in REASONS_TO_REMOVE else 0
            print(f"{_verb(why, dry_run)} {len(group)} runs ({by_engine}), {size_text(size)}: {words}")
        for run in group if dry_run and why in REASONS_TO_REMOVE else ():
            print(f"    {paths.shown(run.folder)}")
    if left:
        print(f"{_verb('', dry_run)} {len(left)} folders of killed processes, {size_text(left_bytes)}")
    for folder in left if dry_run else ():
        print(f"    {paths.shown(folder)}")
    for home in () if dry_run else homes:
        leased(home)  # removes them
    if (words := batches_text(runs)) and not (scenes or engines or settings):
        print(f"kept {words}; batches use those of unchanged decks and builds; remove the folder to free the space")
    print(f"{'would free' if dry_run else 'freed'} {size_text(freed + left_bytes)}")


def _verb(why: str, dry_run: bool) -> str:
    return "kept" if why in REASONS_TO_KEEP else "would remove" if dry_run else "removed"


def _reasons(kept: Sequence[KeptRun]) -> dict[Path, str]:
    """Reason to remove or keep each run, a key of ``REASONS_TO_REMOVE`` or ``REASONS_TO_KEEP``."""
    builds = {engine: _present_build(engine) for engine in {run.engine for run in kept}}
    reasons = {run.folder: _reason(run, builds[run.engine]) for run in kept}
    used = [run for run in kept if reasons[run.folder] == "used"]
    decks = {run.key: run.record.deck_sha256 for run in used if run.record}  # the newest is last
    former = {run.folder: "deck" for run in used if run.record and run.record.deck_sha256 != decks[run.key]}
    return reasons | former


def _reason(run: KeptRun, build: Build | None) -> str:
    if not FOLDER_NAME.fullmatch(run.folder.name):
        return "named"
    if time.time() - max((stat.st_mtime for stat in run.files.values()), default=0.0) < RECENT_S:
        return "recent"
    if run.record is None:
        return "unread"
    if run.trouble:
        return "failed"
    if build is None:
        return "absent"
    present = run_identity(run.engine, build, run.record.deck_sha256)
    return "used" if run.record.identity == present else "build"


def _present_build(engine: str) -> Build | None:
    """Installed build of an engine; None if there is none or its version is unknown."""
    with suppress(InputError, RunError):
        build = build_of(load_engine(engine))
        return build if build.version != UNKNOWN_VERSION else None
    return None


def _remove(group: Sequence[KeptRun]) -> list[KeptRun]:
    """Remove runs, except those replaced by another process meanwhile; return the removed runs."""
    gone = []
    for home in {run.folder.parent for run in group}:
        with workplace(home) as place:  # moved here first: the workplace is removed in any case
            for run in group:
                away = place / run.folder.name
                if run.folder.parent == home:
                    with suppress(FileNotFoundError):
                        run.folder.rename(away)
                        if read_record(away) == run.record:
                            gone.append(run)
                        else:
                            away.rename(run.folder)
    return gone


def _homes(runs: Path) -> list[Path]:
    """Folders that may contain workplaces."""
    return [*runs.glob("[!.]*/"), Store(runs).folder / WORK]
