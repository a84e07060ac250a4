"""Planning for notebooks and scripts: the case of a scene and the errors to expect."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.chain.case import Case
from drivers.engines import VERLET
from drivers.limits.refusal import FORCE
from drivers.scene.settings import setting_texts
from validation.accuracy.motions import predicted_error
from validation.accuracy.plan import planned_case


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
        (1.6666666666666665e-07, True)
    """
    case = planned_case(scene, *setting_texts(settings or {}))
    if case.plan is not None:
        return case, dict(case.plan.predicted)
    return case, {FORCE: float(predicted_error(case, engine).max())}
