"""``run.json``: what was run, with what, how it ended and what it cost."""

import json
import platform
import subprocess
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.files import sha256_of, whole_file

FILE = "run.json"
UNASSESSED: dict[str, Any] = dict.fromkeys(("error_budget", "error_note", "warnings", "step_limit_s", "accuracy"))


@dataclass(frozen=True)
class RunRecord:
    """The record of one run; times in seconds.

    What ``validation.accuracy.assess`` adds is None until a run that is done has been assessed: ``error_budget``,
    ``error_note``, ``warnings``, ``step_limit_s``, ``accuracy``.

    Attributes:
        status: ``done``, ``failed`` or ``timeout``; ``reason`` says why in the latter cases.
        scene: resolved, in SI units.
        layout: what post-processing needs to know of the chain (``drivers.chain.layout.Layout``).
        elements: modelling elements, each in or out with its reason.
        wall_s, cpu_s: of the whole process.
        loop_s: of the engine's own time loop.
        error_budget: parts of the error of the force and of what gauges show (``validation.accuracy.budget.Parts``).
        error_note: what of it could not be measured, and why.
        warnings: of a run that is done and of little use.
        step_limit_s: the predicted stability limit of the time step; None too where no contact closes.
        accuracy: by quantity what was ``asked``, ``predicted`` and ``measured``; None too where none is asked for.
        forces_sha256: of ``forces.parquet``, so that a damaged one is not taken for done; empty where there is none.
    """

    engine: str
    engine_version: str
    scene_name: str
    status: str
    reason: str
    scene: dict[str, Any]
    layout: dict[str, Any]
    elements: list[dict[str, Any]]
    deck_sha256: str
    command: str
    time_step_s: float
    steps: int
    bodies: int
    wall_s: float
    cpu_s: float
    loop_s: float | None
    memory_bytes: int
    forces_sha256: str
    error_budget: list[dict[str, Any]] | None
    error_note: str | None
    warnings: list[str] | None
    step_limit_s: float | None
    accuracy: dict[str, dict[str, float]] | None
    host: str
    commit: str
    dirty: bool
    lock_sha256: str

    def write(self, folder: Path) -> None:
        """Writes ``run.json`` into the run folder."""
        with whole_file(folder / FILE) as draft:
            draft.write_text(json.dumps(asdict(self), indent=2) + "\n")


def read_record(folder: Path) -> RunRecord | None:
    """The record of a run folder; None where there is none that can be read."""
    try:
        record = RunRecord(**json.loads((folder / FILE).read_text()))
        for part in record.error_budget or ():
            shares = [share for key, share in part.items() if key not in ("quantity", "where")]
            if not (isinstance(part["quantity"], str) and all(isinstance(share, float | int) for share in shares)):
                raise ValueError("an error budget of something else")
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None
    return record


@cache
def provenance() -> dict[str, Any]:
    """Host, commit, whether the work tree differs from it, and the lock file's digest."""
    commit = _git("rev-parse", "HEAD")
    return {
        "host": f"{platform.node()}, {platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "commit": commit or "unknown",
        "dirty": bool(_git("status", "--porcelain")),
        "lock_sha256": sha256_of(paths.LOCK) if paths.LOCK.exists() else "",
    }


def _git(*words: str) -> str:
    try:
        done = subprocess.run(("git", *words), cwd=paths.ROOT, capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""
