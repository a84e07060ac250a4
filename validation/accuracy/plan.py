"""Planning of a case: the largest time step that meets the accuracy of its scene, and engines by cost."""

import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import RunError
from drivers.base.kept import recall
from drivers.base.progress import say
from drivers.chain.case import Case, build_case
from drivers.chain.residual import FORCE
from drivers.engines import VERLET, engine_names, installed, load_engine
from drivers.limits.refusal import inability
from drivers.run.build import build_of
from drivers.run.run import run_identity
from drivers.run.run_folder import find_run
from drivers.scene.read_scene import read_scene
from drivers.scene.settings import setting_texts
from postproc.read.observables import without_unit
from validation.accuracy.costs import cost_on
from validation.accuracy.motions import predicted_error
from validation.accuracy.step_choice import Chooser, simplify


def plan(
    scene: str | Path, settings: Mapping[str, Any] | None = None, engine: str = VERLET
) -> tuple[Case, dict[str, float]]:
    """Plan a scene: choose the time step where the scene asks for an accuracy, and predict the errors.

    Args:
        scene: Name of a scene in ``inputs/scenes``, or path of a scene file.
        settings: Values that replace those of the scene file, by key: text with a unit (``"2 m/s"``) or a number in
            SI units; None removes the key.
        engine: Engine whose error is predicted for a scene with a time step of its own; all codes have the scheme of
            ``"verlet"``.

    Returns:
        case: The scene with its time step, for ``drivers.run_scene``.
        errors: Predicted error of each quantity that the scene asks for, or of ``force``: the largest difference from
            the exact motion over all contacts and times, relative to the largest change of force. Errors of other
            quantities are relative to their exact value (of a peak: to the peak above the static load).

    Raises:
        InputError: The scene or a setting is wrong, or no time step keeps the accuracy.

    Examples:
        >>> case, errors = plan("fig4", {"run.time_step": None, "run.accuracy": 1e-4})
        >>> case.scene.time_step_s, errors["force"] <= 1e-4
        (1.6666666666666668e-07, True)
    """
    case = planned_case(scene, *setting_texts(settings or {}))
    if case.plan is not None:
        return case, dict(case.plan.predicted)
    return case, {FORCE: float(predicted_error(case, engine).max())}


def capable_engines(case: Case, among: Collection[str] = ()) -> list[str]:
    """Engines, installed or not, that can run a case with its accuracy; ``among`` others, if given."""
    names = among or engine_names()
    return [name for name in names if inability(case, name) is None]


def auto_engines(case: Case, runs: Path | None = None) -> Iterator[str]:
    """Installed engines that can run a case, the cheapest first; those with a ``fault`` become lines on stderr.

    Raises:
        RunError: no engine is left.
    """
    capable = capable_engines(case)
    by_cost = sorted(installed(capable), key=lambda name: cost_on(name).run_s(case))
    for name in by_cost:
        if why := fault(case, name, runs):
            say(f"{case.scene.name}: {name}: {why}; --engine auto leaves it out")
        else:
            yield name
    if by_cost:
        raise RunError(f"{case.scene.name}: no engine is left for --engine auto, after {', '.join(by_cost)}")
    others = f"; {', '.join(capable)} would" if capable else ""
    raise RunError(f"no installed engine models all of this scene{others}")


def fault(case: Case, name: str, runs: Path | None = None) -> str:
    """Reason to leave out an engine: its build failed ``beads engine``, or its run of the case in ``runs`` failed."""
    if recall(kit_key(name)) is False:
        return f"its build failed beads engine {name}"
    with suppress(RunError):  # a faulty adapter renders no deck
        engine = load_engine(name)
        identity = run_identity(name, build_of(engine), engine.render(case).sha256) if runs else ""
        if runs and (run := find_run(runs / name, identity, {})) and not run.done:
            return f"{run.trouble} (see {paths.shown(run.folder)}; --rerun tries again)"
    return ""


def kit_key(name: str) -> list[str]:
    """Key in the cache of the outcome of ``beads engine``: True if the installed build passed."""
    return ["kit", name, build_of(load_engine(name)).identity]


def planned_case(source: str | Path, *settings: str) -> Case:
    """Planned case of a scene with settings.

    Raises:
        InputError: the scene or its accuracy is wrong.
    """
    return plan_case(build_case(read_scene(source, settings)))


def plan_case(case: Case) -> Case:
    """Case at the largest time step that meets its accuracy, without elements of negligible effect.

    The step leaves room for rounding errors. A case without an accuracy is returned unchanged.

    Raises:
        InputError: no step meets the accuracy, or the scene lacks one of its quantities.
    """
    accuracy = case.scene.run.accuracy
    if accuracy is None:
        return case
    began = time.perf_counter()
    by_quantity = accuracy if isinstance(accuracy, dict) else {FORCE: accuracy}
    asked = {without_unit(name): share for name, share in by_quantity.items()}
    chooser = Chooser(simplify(case, asked), asked)
    chosen, plan = chooser.choose(asked)
    return replace(chosen, plan=replace(plan, asked=asked, seconds=round(time.perf_counter() - began, 6)))
