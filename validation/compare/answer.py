"""First sentences on compared scenes: whether the codes are right, how exact they are, and at what cost."""

from collections.abc import Iterable, Mapping, Sequence

from drivers.base.progress import in_words
from drivers.chain.residual import FORCE
from drivers.engines import VERLET, in_order, load_engine
from validation.accuracy.budget import ERROR, MODEL
from validation.checks import FAIL, NOT_RUN, Check, outcome, short
from validation.compare.comparison import ComparedScene

Outcomes = Mapping[str, Mapping[str, str]]  # verdicts by scene or case, and by engine
INACCURATE = "inaccurate"  # the right computation, with larger errors than allowed


def answer(scenes: Sequence[ComparedScene], cases: Outcomes | None = None) -> list[str]:
    """Sentences that say if the codes agree: failures first, then the agreement, then missing runs.

    Args:
        scenes: compared scenes.
        cases: verdicts of independent cases, by case and engine.
    """
    rows = {scene.case.scene.name: _outcomes(scene) for scene in scenes}
    checks = [c for scene in scenes for c in scene.checks if rows[c.scene][c.engine] not in (FAIL, INACCURATE)]
    ran = {name for scene in scenes for name in scene.runs}
    codes = [name for name in in_order({check.engine for check in checks} & ran) if not _in_repository(name)]
    failures = [
        *_by_engine(rows | dict(cases or {}), FAIL, "fails", "fail"),
        *_by_engine(rows, INACCURATE, "is right but not accurate enough", "are right but not accurate enough"),
    ]
    missing = _by_engine(rows, NOT_RUN, "did not run", "did not run")
    warned = [scene.case.scene.name for scene in scenes if any(run.record.warnings for run in scene.runs.values())]
    remarks = [f"{'; '.join(missing)}."] if missing else []
    remarks += [f"Runs of {listed(warned)} have warnings."] if warned else []
    agreement = _agreement(scenes, checks, codes or [name for name in (VERLET,) if name in ran])
    if failures:
        rest = [f"Otherwise, {agreement}"] if agreement else []
        return [f"No: {'; '.join(failures)}.", *rest, *remarks]
    if codes and agreement:
        return [f"Yes: {agreement}", *remarks]
    rest = [f"In this repository, {agreement}"] if agreement else []
    why = "their runs have nothing to be compared with" if codes else "none of them ran"
    return [f"Not known whether the codes are right: {why}.", *rest, *remarks]


def display_name(engine: str) -> str:
    """Name of an engine in a sentence: a code's own name in capitals, as its authors write it."""
    loaded = load_engine(engine)
    return engine.upper() if not loaded.in_repository and engine == loaded.entry.adapter else engine


def listed(items: Sequence[str]) -> str:
    """Words with commas, and "and" before the last."""
    return " and ".join(filter(None, (", ".join(items[:-1]), *items[-1:])))


def _agreement(scenes: Sequence[ComparedScene], checks: Iterable[Check], engines: list[str]) -> str:
    """Clause on the largest deviations and the cost of these engines over all scenes; empty without engines."""
    forces = [check for check in checks if check.engine in engines and check.quantity.endswith(f": {FORCE}")]
    same = [c.value for c in forces if c.quantity == f"{MODEL}: {FORCE}" and not _in_repository(c.engine)]
    exact = [c.value for c in forces if c.quantity == f"{ERROR}: {FORCE}"]
    steps = "at this time step" if len(scenes) == 1 else "at their time steps"
    parts = [f"with velocity Verlet at the same step to {short(max(same))}"] if same else []
    parts += [f"with the exact motion to {short(max(exact))} {steps}"] if exact else []
    if not parts:
        return ""
    where = f"on {number} scenes " if (number := len({check.scene for check in forces})) > 1 else ""
    loops = [scene.runs[name].record.loop_s for scene in scenes for name in engines if name in scene.runs]
    known = [loop_s for loop_s in loops if loop_s is not None]
    cost = f", for {'at most ' if len(known) > 1 else ''}{in_words(max(known))} of computing per run" if known else ""
    return f"{where}the forces of {listed([*map(display_name, engines)])} agree {listed(parts)}{cost}."


def _outcomes(scene: ComparedScene) -> dict[str, str]:
    """Verdict of each engine on a scene."""
    verdicts = {}
    for name in in_order([*scene.runs, *scene.absent]):
        checks = scene.of_engine(name)
        failed = [check.quantity.partition(":")[0] for check in checks if check.verdict == FAIL]
        verdicts[name] = INACCURATE if {*failed} == {ERROR} else outcome(checks)
    return verdicts


def _by_engine(rows: Outcomes, verdict: str, singular: str, plural: str) -> list[str]:
    """Clauses such as "YADE fails on fig4 and fig5", one for all engines that have that verdict on the same scenes."""
    by_engine: dict[str, list[str]] = {}
    for row, cells in rows.items():
        for engine, cell in cells.items():
            if cell == verdict:
                by_engine.setdefault(engine, []).append(row)
    alike: dict[str, list[str]] = {}
    for engine, names in by_engine.items():
        alike.setdefault(listed(names), []).append(display_name(engine))
    return [f"{listed(names)} {singular if len(names) == 1 else plural} on {where}" for where, names in alike.items()]


def _in_repository(engine: str) -> bool:
    return load_engine(engine).in_repository
