"""Checks for programs: ``report.json``, with their provenance."""

import datetime
import os
import platform
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from drivers.base import paths
from drivers.engines import in_order
from drivers.run.run import provenance
from validation.checks import FAIL, NOT_RUN, PASS, Check
from validation.compare.comparison import ComparedScene
from validation.report.scene_section import ReportRow, counted, source_of

LIBRARIES = ("numpy", "scipy", "numba")
CPUS = Path("/proc/cpuinfo")


def made_with(scenes: Sequence[ComparedScene], command: str) -> dict[str, Any]:
    """Date, command, commit, engines, libraries and machine of a report."""
    made = provenance()
    records = {name: run.record for scene in scenes for name, run in scene.runs.items()}
    return {
        "date": _utc(time.time()),
        "command": command,
        "commit": made["commit"],
        "uncommitted_changes": made["dirty"],
        "lock_sha256": made["lock_sha256"],
        "engines": {
            name: {
                "version": records[name].engine_version,
                "command": records[name].executable,
                "sha256": records[name].build_sha256,
            }
            for name in in_order(records)
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
    """File and date of each table of a results folder."""
    return [(paths.shown(path), _utc(path.stat().st_mtime)) for path in sorted(results.glob("*.csv"))]


def _utc(seconds: float) -> str:
    return datetime.datetime.fromtimestamp(seconds, datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")


def cpu_name(file: Path = CPUS) -> str:
    """Processor's name from Linux, else from Python."""
    try:
        lines = file.read_text(errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return next(iter(names), "") or platform.processor() or platform.machine()


SCHEMA = 2
RECORDED = ("status", "engine_version", "executable", "build_sha256", "deck_sha256",
         "commit", "dirty", "host", "time_step_s", "steps", "bodies",
         "wall_s", "cpu_s", "loop_s", "memory_bytes", "step_limit_s", "warnings", "error_budget",
         "error_note", "exact_to", "exact_until_s")  # fmt: skip
SCENES, CASES = "scenes", "independent"  # keys


def as_json(
    made: dict[str, Any],
    scenes: Sequence[ComparedScene],
    rows: Sequence[ReportRow],
    cases: Sequence[ReportRow],
    unmet: Mapping[str, str],
    to_come: Sequence[str],
) -> str:
    """Report as JSON, with the names of chapters still to come; NaN and infinities become null."""
    data = {
        "schema_version": SCHEMA,
        "made_with": made,
        "unmet": unmet,
        "to_come": to_come,
        "counts": {
            SCENES: _counts(counted(rows)),
            CASES: _counts(counted(cases)),
            "checks": _counts(Counter(check.verdict for row in (*rows, *cases) for check in _checks(row))),
        },
        SCENES: [_scene(scene, row) for scene, row in zip(scenes, rows, strict=True)],
        CASES: [_row(row) for row in cases],
    }
    text = TypeAdapter(Any).dump_json(data, indent=1, fallback=lambda scalar: scalar.item())
    return f"{text.decode()}\n"


def _counts(found: Counter[str]) -> dict[str, int]:
    return {kind: found[kind] for kind in (PASS, FAIL, NOT_RUN)}


def _checks(row: ReportRow) -> list[Check]:
    return [check for cell in row.cells.values() for check in cell.checks]


def _scene(scene: ComparedScene, row: ReportRow) -> dict[str, Any]:
    case = scene.case
    found = _row(row) | {
        "summary": case.summary,
        "source": source_of(case.scene),
        "time_step_s": case.scene.time_step_s,
        "elements": [asdict(element) for element in case.elements],
    }
    for engine, own in found["engines"].items():
        if engine in scene.runs:
            run = scene.runs[engine]
            own["run"] = {"folder": paths.shown(run.folder)} | {name: getattr(run.record, name) for name in RECORDED}
        own["departure"] = scene.departures.get(engine)
    return found


def _row(row: ReportRow) -> dict[str, Any]:
    return {
        "name": row.name,
        "title": row.title,
        "command": row.again,
        "engines": {
            engine: {
                "verdict": cell.verdict,
                "note": cell.note,
                "worst": cell.worst.quantity if cell.worst else None,
                "diagnosis": cell.diagnosis or None,
                "checks": [
                    {key: value for key, value in asdict(each).items() if key not in ("scene", "engine")}
                    for each in cell.checks
                ],
            }
            for engine, cell in row.cells.items()
        },
    }
