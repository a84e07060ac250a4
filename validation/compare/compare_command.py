"""``beads compare SCENE``: checks, diagnoses and error budgets of scenes on screen."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from drivers.base.progress import counted
from drivers.base.text_table import text_table
from drivers.engines import in_order
from validation.accuracy.budget import budget_lines
from validation.checks import FAIL, NOT_RUN, Check, outcome, summary, table, worst_of
from validation.compare.answer import answer
from validation.compare.comparison import ComparedScene, run_and_compare_all
from validation.compare.selection import EngineSelection, print_unmet


def compare_scenes(
    sources: Sequence[str],
    settings: tuple[str, ...],
    runs: Path,
    asked: EngineSelection,
    *,
    unsafe: bool,
    brief: bool = False,
) -> int:
    """Prints checks, diagnoses and error budgets of scenes.

    With ``brief`` the answer and the worst check of each engine. The exit code is 1 if a check fails or a required
    engine did not run.

    Raises:
        InputError: a scene is wrong, or a run would be refused and ``unsafe`` is False.
    """
    checks: list[Check] = []
    ran, absent = set[str](), dict[str, str]()
    with counted(f"{sources[0] if len(sources) == 1 else f'{len(sources)} scenes'} on all engines, compared"):
        for compared in run_and_compare_all(sources, settings, runs, asked, unsafe=unsafe):
            ran |= compared.ran
            for engine, why in compared.absent.items():
                absent.setdefault(engine, why)
            print(*(_brief_lines(compared) if brief else _lines(compared, asked)), "", sep="\n", flush=True)
            checks += compared.checks
    failed = any(check.verdict == FAIL for check in checks)
    return 1 if print_unmet(asked.unmet(ran, absent)) or failed else 0


def _headline(compared: ComparedScene, asked: EngineSelection) -> str:
    """Summary of the checks; says first which engines that have to run did not."""
    missing = [name for name in asked.needed if outcome(compared.of_engine(name)) == NOT_RUN]
    if not missing or outcome(compared.checks) == FAIL:
        return summary(compared.checks)
    why = "; ".join(f"{name} did not run ({compared.absent[name]})" for name in missing)
    rest = [check for check in compared.checks if check.engine not in missing]
    return f"not judged: {why}; the rest: {summary(rest)}"


def _brief_lines(compared: ComparedScene) -> Iterator[str]:
    """The answer, and for each engine the failed check or the check closest to its limit."""
    yield " ".join(answer([compared]))
    by_engine = [compared.of_engine(engine) for engine in in_order([*compared.runs, *compared.absent])]
    yield from table([worst_of(checks) or checks[0] for checks in by_engine])


def _lines(compared: ComparedScene, asked: EngineSelection) -> Iterator[str]:
    """Lines on a scene: summary, checks, diagnoses, error budgets."""
    name = compared.case.scene.name
    yield f"{name}: {_headline(compared, asked)}"
    yield " ".join(answer([compared]))
    yield "model: difference from velocity Verlet at the same step; error: difference from the exact motion;"
    yield "both relative to the largest change of force, unless stated otherwise\n"
    yield from table(compared.checks)
    yield from [""] * bool(compared.diagnoses)
    yield from text_table([(name, *said) for said in compared.diagnoses.items()])
    yield from budget_lines("engine", compared.runs)
