"""Checks for programs: ``report.json``, with their provenance."""

import datetime
import os
import platform
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from drivers.base import paths
from drivers.engines import in_order
from drivers.run.run import provenance
from validation.checks import FAIL, NOT_RUN, PASS
from validation.compare.comparison import ComparedScene
from validation.report.parts import PARTS
from validation.report.scene_section import counted, source_of

LIBRARIES = ("numpy", "scipy", "numba")
CPUS = Path("/proc/cpuinfo")


def made_with(scenes: Sequence[ComparedScene], command: str) -> dict[str, Any]:
    """Date, command, commit, engines, libraries and machine of a report."""
    made = provenance()
    records = {name: run.record for scene in scenes for name, run in scene.runs.items()}
    keys = {"version": "engine_version", "command": "executable", "sha256": "build_sha256"}
    return {
        "date": _utc(time.time()),
        "command": command,
        "commit": made["commit"],
        "uncommitted_changes": made["dirty"],
        "lock_sha256": made["lock_sha256"],
        "engines": {
            name: {key: getattr(records[name], field) for key, field in keys.items()} for name in in_order(records)
        },
        "libraries": {"python": platform.python_version()} | {name: version(name) for name in LIBRARIES},
        "machine": {
            "host": platform.node(),
            "system": platform.platform(),
            "processor": cpu_name(),
            "cores": os.cpu_count() or 1,
        },
    }


def when_made(results: Path) -> list[tuple[str, str]]:
    """Name and date of each stored chapter and figure of a results folder."""
    return [(path.stem, _utc(path.stat().st_mtime)) for path in sorted((results / PARTS).glob("*.json"))]


def _utc(seconds: float) -> str:
    return datetime.datetime.fromtimestamp(seconds, datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")


def cpu_name() -> str:
    """Processor's name from Linux, else from Python."""
    lines = CPUS.read_text(errors="replace").splitlines() if CPUS.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, "") or platform.processor() or platform.machine()


SCHEMA = 3
LEFT_OUT = ("scene", "layout", "elements", "files")  # of the record of a run
SCENES, CASES = "scenes", "independent"  # keys


def as_json(
    made: dict[str, Any],
    scenes: Sequence[ComparedScene],
    rows: Sequence[Mapping[str, Any]],
    cases: Sequence[Mapping[str, Any]],
    unmet: Mapping[str, str],
    to_come: Sequence[str],
) -> str:
    """Report as JSON, with the names of chapters still to come; NaN and infinities become null."""
    checks = Counter(
        check.verdict for row in (*rows, *cases) for cell in row["engines"].values() for check in cell["checks"]
    )
    counts = {SCENES: counted(rows), CASES: counted(cases), "checks": checks}
    data = {
        "schema_version": SCHEMA,
        "made_with": made,
        "unmet": unmet,
        "to_come": to_come,
        "counts": {key: {kind: verdicts[kind] for kind in (PASS, FAIL, NOT_RUN)} for key, verdicts in counts.items()},
        SCENES: [_scene(scene, row) for scene, row in zip(scenes, rows, strict=True)],
        CASES: cases,
    }
    text = TypeAdapter(Any).dump_json(data, indent=1, fallback=lambda scalar: scalar.item())
    return f"{text.decode()}\n"


def _scene(scene: ComparedScene, row: Mapping[str, Any]) -> dict[str, Any]:
    case, engines = scene.case, dict(row["engines"])
    for engine, run in scene.runs.items():
        record = {name: value for name, value in vars(run.record).items() if name not in LEFT_OUT}
        engines[engine] = engines[engine] | {"run": {"folder": paths.shown(run.folder)} | record}
    return {
        **row,
        "engines": engines,
        "summary": case.summary,
        "source": source_of(case.scene),
        "time_step_s": case.scene.time_step_s,
        "elements": case.elements,
    }
