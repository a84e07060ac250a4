"""``python -m validation compare SCENE``: verdicts, departures, diagnoses and error budgets of scenes on screen."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from drivers.base import paths
from drivers.base.progress import step
from drivers.engines import in_order
from validation.accuracy.budget import BUDGET_WORDS, PARTS, budget_lines
from validation.compare.answer import answer
from validation.compare.comparison import ComparedScene, run_and_compare_all
from validation.compare.departure import departure_rows
from validation.compare.selection import EngineSelection, print_unmet
from validation.compare.verdict import (
    FAIL,
    NOT_RUN,
    RUN,
    Columns,
    Verdict,
    outcome,
    share_of_tolerance,
    short,
    summary,
    table,
    without_run,
)


def compare_scenes(
    sources: Sequence[str],
    settings: tuple[str, ...],
    runs: Path,
    asked: EngineSelection,
    *,
    unsafe: bool,
    brief: bool = False,
) -> int:
    """Prints verdicts, departures, diagnoses and error budgets of scenes.

    Selected builds of one code are also compared with each other; without ``sources`` only that, on all shipped
    scenes. With ``brief`` the answer and a line for each engine. The exit code is 1 if a verdict is a failure or a
    required engine did not run.

    Raises:
        InputError: a scene is wrong, or a run would be refused and ``unsafe`` is False.
    """
    verdicts: list[Verdict] = []
    between: list[Verdict] = []
    ran, absent = set[str](), dict[str, str]()
    scenes = sources or sorted(path.stem for path in paths.SCENES.glob("*.toml"))
    with step(f"{scenes[0] if len(scenes) == 1 else f'{len(scenes)} scenes'} on all engines, compared"):
        for compared in run_and_compare_all(scenes, settings, runs, asked, unsafe=unsafe):
            between += [verdict for pair in asked.builds for verdict in _between(compared, *pair)]
            ran |= set(compared.wall_s)
            for engine, why in compared.absent.items():
                absent.setdefault(engine, why)
            if sources:
                print(*(_brief_lines(compared) if brief else _lines(compared, asked)), "", sep="\n", flush=True)
                verdicts += compared.verdicts
    if between:
        print(*table(between), sep="\n")
    failed = any(verdict.verdict == FAIL for verdict in verdicts + between)
    return 1 if print_unmet(asked.unmet(ran, absent)) or failed else 0


def _between(compared: ComparedScene, one: str, other: str) -> list[Verdict]:
    """Verdicts on the quantities that differ between two builds of a code."""
    scene, pair = compared.case.scene.name, f"{other} against {one}"
    why = [f"{engine}: {compared.absent[engine]}" for engine in (one, other) if engine in compared.absent]
    if why:
        failed = any(v.verdict == FAIL for v in compared.verdicts if v.engine in (one, other) and v.quantity == RUN)
        return [without_run(scene, pair, "; ".join(why), FAIL if failed else NOT_RUN)]
    from validation.compare.moved import moved  # slow import

    rows = moved(compared.runs[one].folder, compared.runs[other].folder)
    return [replace(verdict, scene=scene, engine=pair) for verdict in rows]


def _headline(compared: ComparedScene, asked: EngineSelection) -> str:
    """Summary of the verdicts; says first which engines that have to run did not."""
    by_engine = {name: [each for each in compared.verdicts if each.engine == name] for name in compared.absent}
    missing = [name for name in asked.needed if outcome(by_engine.get(name, [])) == NOT_RUN]
    if not missing or any(each.verdict == FAIL for each in compared.verdicts):
        return summary(compared.verdicts)
    why = "; ".join(f"{name} did not run ({compared.absent[name]})" for name in missing)
    return f"not judged: {why}; the rest: {summary([v for v in compared.verdicts if v.engine not in missing])}"


def _brief_lines(compared: ComparedScene) -> Iterator[str]:
    """The answer, and a line for each engine: its verdict, and the failed check or the check closest to its limit."""
    yield " ".join(answer([compared]))
    columns = Columns.fitting((each.scene, each.engine, each.quantity) for each in compared.verdicts)
    for engine in in_order([*compared.runs, *compared.absent]):
        own = [verdict for verdict in compared.verdicts if verdict.engine == engine]
        if not own:
            continue
        found, worst = outcome(own), max(own, key=lambda each: (each.verdict == FAIL, share_of_tolerance(each)))
        start = f"{columns.names(compared.case.scene.name, engine)} {found}"
        if worst.quantity == RUN:
            yield f"{start}: {worst.where}"
        else:
            close = "" if found == FAIL else f"{len(own)} checks, closest to its limit: "
            yield f"{start}: {close}{worst.quantity} {short(worst.value)}, allowed {short(worst.limit)}"


def _lines(compared: ComparedScene, asked: EngineSelection) -> Iterator[str]:
    """Lines on a scene: summary, verdicts, first departures, diagnoses, error budgets."""
    name = compared.case.scene.name
    budgets = {engine: [*budget_lines(run.record.error_budget or ())] for engine, run in compared.runs.items()}
    rows = [(each.scene, each.engine, each.quantity) for each in compared.verdicts]
    rows += [(name, engine, quantity) for engine, lines in budgets.items() for quantity, _ in lines]
    columns = Columns.fitting(rows)
    yield f"{name}: {_headline(compared, asked)}"
    yield " ".join(answer([compared]))
    yield "errors are relative to the largest change of force, unless stated otherwise\n"
    yield columns.heading()
    yield from map(columns.line_of, compared.verdicts)
    yield ""
    for engine, each in departure_rows(compared.departures):
        yield f"{columns.names(name, engine)} {each.words}"
    for engine, sentence in compared.diagnoses.items():
        yield f"{columns.names(name, engine)} diagnosis: {sentence}"
    yield f"\nerror budget: {BUDGET_WORDS}"
    yield f"{columns.names('scene', 'engine')} {'quantity':<{columns.quantity}} " + " ".join(f"{p:>10}" for p in PARTS)
    for engine, run in compared.runs.items():
        lines = [f"{quantity:<{columns.quantity}} {numbers}" for quantity, numbers in budgets[engine]]
        lines += [f"warning: {warning}" for warning in run.record.warnings or ()]
        lines += [run.record.error_note] if run.record.error_note else []
        yield from (f"{columns.names(name, engine)} {line}" for line in lines)
