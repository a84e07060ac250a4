"""``beads compare SCENE``: whether the codes are right, how exact they are and at what cost, checks and budgets."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

from drivers.base.terminal import counted, in_words, say, text_table
from drivers.chain.trace import FORCE
from drivers.engines import VERLET, in_order, load_engine
from validation.accuracy.budget import ERROR, MODEL, budget_lines
from validation.checks import FAIL, NOT_RUN, Check, outcome, short, summary, table, worst_of
from validation.compare.comparison import ComparedScene, EngineSelection, run_and_compare_all

Outcomes = Mapping[str, Mapping[str, str]]  # verdicts by scene or case, and by engine
INACCURATE = "inaccurate"  # the right computation, with larger errors than allowed


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
    scenes = []
    with counted(f"{sources[0] if len(sources) == 1 else f'{len(sources)} scenes'} on all engines, compared"):
        for compared in run_and_compare_all(sources, settings, runs, asked, unsafe=unsafe):
            print(*(_brief_lines(compared) if brief else _lines(compared, asked)), "", sep="\n", flush=True)
            scenes.append(compared)
    unmet = asked.unmet(scenes)
    if unmet:
        say("; ".join(unmet.values()))
    return 1 if unmet or any(check.verdict == FAIL for scene in scenes for check in scene.checks) else 0


def _headline(compared: ComparedScene, asked: EngineSelection) -> str:
    """Summary of the checks; says first which engines that have to run did not."""
    rest = [check for check in compared.checks if check.verdict != NOT_RUN or check.engine not in asked.needed]
    missing = [f"{check.engine} did not run ({check.where})" for check in compared.checks if check not in rest]
    if not missing or outcome(rest) == FAIL:
        return summary(compared.checks)
    return f"not judged: {'; '.join([*missing, summary(rest)])}"


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


def answer(scenes: Sequence[ComparedScene], cases: Outcomes | None = None) -> list[str]:
    """Sentences that say if the codes agree: failures first, then the agreement, then missing runs.

    Args:
        scenes: compared scenes.
        cases: verdicts of independent cases, by case and engine.
    """
    rows = {scene.case.scene.name: _outcomes(scene) for scene in scenes}
    judged = [check for scene in scenes for check in scene.checks if check.verdict != NOT_RUN]
    right = [check for check in judged if rows[check.scene][check.engine] not in (FAIL, INACCURATE)]
    codes = [name for name in in_order({check.engine for check in right}) if not load_engine(name).in_repository]
    failed = [*_by_engine(rows | dict(cases or {}), FAIL, "fails on")]
    failed += _by_engine(rows, INACCURATE, "is right but not accurate enough on")
    first = "Yes." if codes else "Not known whether the codes are right: none of them ran."
    missing = [*_by_engine(rows, NOT_RUN, "did not run on")]
    warned = [scene.case.scene.name for scene in scenes if any(run.record.warnings for run in scene.runs.values())]
    sentences = [f"No: {'; '.join(failed)}." if failed else first, _agreement(scenes, right, codes or [VERLET])]
    sentences += [f"{'; '.join(missing)}."] if missing else []
    sentences += [f"Runs of {listed(warned)} have warnings."] if warned else []
    return [sentence for sentence in sentences if sentence]


def display_name(engine: str) -> str:
    """Name of an engine in a sentence: a code's own name in capitals, as its authors write it."""
    loaded = load_engine(engine)
    return engine.upper() if not loaded.in_repository and engine == loaded.entry.adapter else engine


def listed(items: Sequence[str]) -> str:
    """Words with commas, and "and" before the last."""
    return " and ".join(filter(None, (", ".join(items[:-1]), *items[-1:])))


def _agreement(scenes: Sequence[ComparedScene], right: Sequence[Check], engines: Collection[str]) -> str:
    """Sentence on the largest deviations and the cost of these engines over all scenes; empty without measurements."""
    forces = [check for check in right if check.engine in engines and check.quantity.endswith(f": {FORCE}")]
    schemes = {f"{MODEL}: {FORCE}": "velocity Verlet at the same step", f"{ERROR}: {FORCE}": "the exact motion"}
    largest = {each.quantity: each.value for each in sorted(forces, key=lambda check: check.value)}
    parts = [f"with {words} to {short(largest[name])}" for name, words in schemes.items() if name in largest]
    runs = [scene.runs[name] for scene in scenes for name in engines if name in scene.runs]
    most_s = max((run.record.loop_s or 0.0 for run in runs), default=0.0)
    where = f"On {number} scenes the" if (number := len({check.scene for check in forces})) > 1 else "The"
    cost = f", for at most {in_words(most_s)} of computing per run"
    return f"{where} forces of {listed([*map(display_name, engines)])} agree {listed(parts)}{cost}." if parts else ""


def _outcomes(scene: ComparedScene) -> dict[str, str]:
    """Verdict of each engine on a scene."""
    verdicts = {}
    for name in in_order([*scene.runs, *scene.absent]):
        checks = scene.of_engine(name)
        failed = {check.quantity.partition(":")[0] for check in checks if check.verdict == FAIL}
        verdicts[name] = INACCURATE if failed == {ERROR} else outcome(checks)
    return verdicts


def _by_engine(rows: Outcomes, verdict: str, words: str) -> Iterator[str]:
    """Clauses such as "YADE fails on fig4 and fig5"."""
    for engine in in_order({engine for cells in rows.values() for engine in cells}):
        where = [row for row, cells in rows.items() if cells.get(engine) == verdict]
        if where:
            yield f"{display_name(engine)} {words} {listed(where)}"
