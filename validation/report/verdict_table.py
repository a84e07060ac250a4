"""The verdict table: scenes and independent cases down, engines across."""

import math
import shlex
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.engines import in_order
from drivers.scene.model import Scene
from validation.compare.compared_scenes import ComparedScene
from validation.compare.verdict import FAIL, NOT_RUN, PASS, Verdict

QUANTITIES = {
    "force against verlet": "model: force against the same scheme",
    "motion against verlet": "model: kinetic energy and momentum, likewise",
    "force against reference": "truncation: force against the exact reference",
    "peak of a gauge": "peak of a gauge",
    "speed between gauges": "speed between gauges",
    "energy drift": "energy drift",
    "impulse balance": "impulse balance",
}


@dataclass(frozen=True)
class Cell:
    """What one engine makes of one scene.

    Attributes:
        worst: the figure that comes nearest to its tolerance, or passes it by most; None where nothing was measured.
        note: why it is not run or has no numbers.
        verdicts: all of them.
        diagnosis: what a run that is off matches.
    """

    engine: str
    verdict: str
    worst: Verdict | None
    note: str
    verdicts: list[Verdict]
    cost: str = ""
    diagnosis: str = ""

    @property
    def misses(self) -> list[Verdict]:
        """What failed."""
        return [verdict for verdict in self.verdicts if verdict.verdict == FAIL]


@dataclass(frozen=True)
class Row:
    """A scene or an independent case on all engines.

    Attributes:
        again: the command that shows more of it.
    """

    name: str
    title: str
    again: str
    cells: dict[str, Cell]

    @property
    def fails(self) -> bool:
        """Whether any engine failed."""
        return any(cell.verdict == FAIL for cell in self.cells.values())


def scene_row(scene: ComparedScene, runs: Path | None = None) -> Row:
    """The row of a compared scene, whose run folders are in ``runs`` where that is not the usual place."""
    cells = {}
    for engine in in_order([*scene.runs, *scene.absent]):
        own = [verdict for verdict in scene.verdicts if verdict.engine == engine]
        note, cost = scene.absent.get(engine, ""), _cost(scene, engine)
        cells[engine] = _cell(engine, own, note, cost, scene.diagnoses.get(engine, ""))
    told = scene.case.scene
    again = f"python -m validation compare {source_of(told)}"
    again += f" --runs {shlex.quote(str(runs))}" if runs else ""
    return Row(told.name, told.title or told.name, again, cells)


def case_rows(independent: Mapping[str, Any]) -> list[Row]:
    """The rows of independent cases, of the section on them."""
    rows = []
    for entry in (case["entry"] for case in independent.get("cases", [])):
        of_case = [verdict for verdict in independent["verdicts"] if verdict.scene == entry.id]
        cells = {}
        for engine in in_order({verdict.engine for verdict in of_case}):
            own = [verdict for verdict in of_case if verdict.engine == engine]
            note = next((verdict.where for verdict in own if math.isnan(verdict.limit)), "")
            cells[engine] = _cell(engine, own, note)
        rows.append(Row(entry.id, entry.title, "python -m validation independent", cells))
    return rows


def reasons_of(rows: list[Row]) -> list[str]:
    """Each reason of a worst figure's tolerance once."""
    worst = [cell.worst for row in rows for cell in row.cells.values()]
    return list(dict.fromkeys(verdict.reason for verdict in worst if verdict is not None))


def counted(rows: Iterable[Row]) -> Counter[str]:
    """How many cells passed, failed and were not run."""
    return Counter(cell.verdict for row in rows for cell in row.cells.values())


def worst_of(verdicts: list[Verdict]) -> Verdict | None:
    """The figure with the largest share of its tolerance; one that is no number is the worst of all."""
    measured = [verdict for verdict in verdicts if not math.isnan(verdict.limit)]
    return max(measured, key=lambda verdict: (verdict.verdict == FAIL, share_of(verdict)), default=None)


def share_of(verdict: Verdict) -> float:
    """A figure over its tolerance."""
    if math.isnan(verdict.value):
        return math.inf
    if verdict.limit == 0:
        return math.inf if verdict.value else 0.0
    return verdict.value / verdict.limit


def tolerances(scenes: list[ComparedScene]) -> dict[tuple[str, str, str], list[str]]:
    """The scenes by quantity, limit and reason of every tolerance that was applied."""
    used: dict[tuple[str, str, str], list[str]] = {}
    for verdict in (v for scene in scenes for v in scene.verdicts if not math.isnan(v.limit)):
        quantity = QUANTITIES.get(verdict.quantity, verdict.quantity)
        names = used.setdefault((quantity, number(verdict.limit), verdict.reason), [])
        if verdict.scene not in names:
            names.append(verdict.scene)
    return dict(sorted(used.items()))


def source_of(scene: Scene) -> str:
    """A scene as a command line takes it: its name where it is shipped, else its file."""
    shipped = paths.SCENES / f"{scene.name}.toml"
    same = shipped.is_file() and scene.file and (paths.ROOT / scene.file).resolve() == shipped.resolve()
    return scene.name if same or scene.file == scene.name else shlex.quote(scene.file)


def number(value: float, digits: int = 2) -> str:
    """A number for people; a dash for what was not seen."""
    if math.isnan(value):
        return "–"
    return f"{value:.{digits}g}"


def short(value: float) -> str:
    """Two digits and a power of ten, without the zeros that nobody reads; a dash for what is no number."""
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞"
    digits, _, power = f"{value:.1e}".partition("e")
    return f"{digits}e{int(power)}" if int(power) else digits


def _cell(engine: str, own: list[Verdict], note: str, cost: str = "", diagnosis: str = "") -> Cell:
    found = {verdict.verdict for verdict in own}
    verdict = FAIL if FAIL in found else NOT_RUN if NOT_RUN in found else PASS
    return Cell(engine, verdict, worst_of(own), note, own, cost, diagnosis)


def _cost(scene: ComparedScene, engine: str) -> str:
    if engine not in scene.runs:
        return ""
    record = scene.runs[engine].record
    loop = f", loop {1e3 * record.loop_s:.0f} ms" if record.loop_s is not None else ""
    return f"process {record.wall_s:.2f} s{loop}"
