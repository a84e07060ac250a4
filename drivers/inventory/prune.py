"""Runs that no command would use again, told by why, and removed."""

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
from drivers.inventory.run_folders import NAME, UNREAD, KeptRun, batches_text, kept_runs, select, size_below, size_text
from drivers.run.build import Build, build_of
from drivers.run.finished import read_record
from drivers.run.run import run_identity
from drivers.run.workplaces import leased, leftovers, workplace

RECENT_S = 600.0  # the command that ran it may still read it
REMOVED = {
    "unread": f"{UNREAD}: no command takes them",
    "failed": "failed or without forces: run again when asked for",
    "build": "by another build than the present one, which would run them again",
    "deck": "of a former deck, beside a newer run of the same scene, settings and engine",
}
KEPT = {
    "used": "found again when asked for",
    "recent": f"ended less than {RECENT_S / 60:g} minutes ago: the command that ran them may still read them",
    "absent": "by an engine that is not installed now, so its build is not known",
    "named": "in folders that somebody renamed",
}


def prune(
    runs: Path, scenes: Sequence[str], engines: Sequence[str], settings: Sequence[str], *, dry_run: bool = False
) -> None:
    """Removes runs that no command would use again, of those selected, and prints what goes and what stays, and why.

    With ``dry_run`` nothing is removed, and what would be is listed.
    """
    kept = kept_runs(runs)
    homes = [] if scenes or settings else [runs / engine for engine in engines] or _homes(runs)
    left = [folder for home in homes for folder in leftovers(home)]
    left_bytes = sum(map(size_below, left))
    reasons = _reasons(kept, runs)
    groups: dict[str, list[KeptRun]] = {why: [] for why in (*REMOVED, *KEPT)}
    for run in select(kept, scenes, engines, settings):
        groups[reasons[run.folder]].append(run)
    freed = 0
    for why, words in (REMOVED | KEPT).items():
        group = groups[why]
        if why in REMOVED and not dry_run:
            group = _remove(group)
        if group:
            counts = sorted(Counter(run.engine for run in group).items())
            told = ", ".join(f"{name} {count}" for name, count in counts)
            size = sum(run.size for run in group)
            freed += size if why in REMOVED else 0
            print(f"{_verb(why, dry_run)} {len(group)} runs ({told}), {size_text(size)}: {words}")
        for run in group if dry_run and why in REMOVED else ():
            print(f"    {paths.shown(run.folder)}")
    if left:
        print(f"{_verb('', dry_run)} {len(left)} folders of killed processes, {size_text(left_bytes)}")
    for folder in left if dry_run else ():
        print(f"    {paths.shown(folder)}")
    for home in () if dry_run else homes:
        leased(home)  # clears them
    if (words := batches_text(runs)) and not (scenes or engines or settings):
        print(f"kept {words}: batches find them again")
    print(f"{'would free' if dry_run else 'freed'} {size_text(freed + left_bytes)}")


def _verb(why: str, dry_run: bool) -> str:
    return "kept" if why in KEPT else "would remove" if dry_run else "removed"


def _reasons(kept: Sequence[KeptRun], runs: Path) -> dict[Path, str]:
    """Why each run goes or stays, as a word of ``REMOVED`` or ``KEPT``."""
    builds = {engine: _present_build(engine, runs / engine) for engine in {run.engine for run in kept}}
    reasons = {run.folder: _reason(run, builds[run.engine]) for run in kept}
    used = [run for run in kept if reasons[run.folder] == "used"]
    decks = {run.key: run.record.deck_sha256 for run in used if run.record}  # the newest comes last
    former = {run.folder: "deck" for run in used if run.record and run.record.deck_sha256 != decks[run.key]}
    return reasons | former


def _reason(run: KeptRun, build: Build | None) -> str:
    if not NAME.fullmatch(run.folder.name):
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
    return "used" if run.folder.name.endswith(f"-{present}") else "build"


def _present_build(engine: str, home: Path) -> Build | None:
    """The build that would run now; None where there is none, or it does not say what it is."""
    with suppress(InputError, RunError):
        build = build_of(load_engine(engine), home)
        return build if build.version != UNKNOWN_VERSION else None
    return None


def _remove(group: Sequence[KeptRun]) -> list[KeptRun]:
    """Removes runs, but none that another process has replaced meanwhile; those removed."""
    gone = []
    for home in {run.folder.parent for run in group}:
        with workplace(home) as place:  # where nobody finds them, and which is cleared afterwards, whatever happens
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
    """Folders in which processes work."""
    return [*runs.glob("[!.]*/"), Store(runs).folder / WORK]
