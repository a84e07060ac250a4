"""What the report was made with: versions, machine, commit, date, command."""

import datetime
import os
import platform
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.engines import in_order
from drivers.run.finished import provenance
from validation.compare.compared_scenes import ComparedScene

LIBRARIES = ("numpy", "scipy", "numba")
CPUS = Path("/proc/cpuinfo")


def made_with(scenes: list[ComparedScene], command: str) -> dict[str, Any]:
    """All of it, for the page and for ``report.json``."""
    made = provenance()
    engines = {name: run.record.engine_version for scene in scenes for name, run in scene.runs.items()}
    return {
        "date": _utc(time.time()),
        "command": command,
        "commit": made["commit"],
        "uncommitted_changes": made["dirty"],
        "lock_sha256": made["lock_sha256"],
        "engines": {name: engines[name] for name in in_order(engines)},
        "libraries": {"python": platform.python_version()} | {name: version(name) for name in LIBRARIES},
        "machine": {
            "host": platform.node(),
            "system": platform.platform(),
            "processor": cpu_name(),
            "cores": os.cpu_count() or 1,
        },
    }


def when_made(results: Path) -> dict[str, dict[str, str]]:
    """When each table of a results folder was made, and where it is, by its name."""
    return {
        path.name: {"file": paths.shown(path), "date": _utc(path.stat().st_mtime)} for path in results.glob("*.csv")
    }


def _utc(seconds: float) -> str:
    return datetime.datetime.fromtimestamp(seconds, datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")


def cpu_name(file: Path = CPUS) -> str:
    """The processor as Linux names it, else as Python does."""
    try:
        lines = file.read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(iter(names), "") or platform.processor() or platform.machine()
