"""Functions for notebooks and scripts: run a scene, open a finished run, read the rows of a study."""

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.processes import end, start
from drivers.batch.tables import read_study_table
from drivers.chain.case import Case, build_case
from drivers.limits import refuse
from drivers.run.inventory import run_folder
from drivers.run.run import run_case
from drivers.run.run_folder import EndedRun
from drivers.run.run_folder import open_run as open_folder
from drivers.scene.read_scene import read_scene
from drivers.scene.settings import setting_texts

__all__ = ["explore", "open_run", "read_study_table", "run_scene"]

PAGE_PX = 900  # height of a live page in a notebook


def run_scene(
    scene: str | Path | Case,
    engine: str,
    settings: Mapping[str, Any] | None = None,
    *,
    runs: str | Path | None = None,
    rerun: bool = False,
    time_limit_s: float | None = None,
) -> EndedRun:
    """Run a scene on an engine; a run with the same deck and build that is done already is returned as it is.

    The run folder holds the deck and the forces. ``validation.assess(run, case)`` adds the gauge signals and the error
    budget, as the command ``beads run`` does.

    Args:
        scene: Name of a scene in ``inputs/scenes``, path of a scene file, or a case planned by ``validation.plan``.
        engine: Name of an engine, such as ``"yade"``, ``"verlet"`` or ``"reference"``.
        settings: Values that replace those of the scene file, by key: text with a unit (``"2 m/s"``) or a number in
            SI units; None removes the key.
        runs: Folder of the run folders; by default ``runs/`` of the checkout.
        rerun: True runs the scene again even if it is done.
        time_limit_s: Seconds after which the run is stopped; by default a limit for the engine and the size of the
            scene.

    Returns:
        EndedRun: Its ``folder`` is a Path, its ``record`` holds what is known about it, and its ``trace`` holds
            ``time_s`` of shape (samples,) and ``force_N`` of shape (samples, contacts); column j - 1 is contact j,
            under body j, counted from the wall.

    Raises:
        InputError: The scene or a setting is wrong, the time step is unstable, or the engine cannot model the scene.
        RunError: The engine is not installed, or the run failed.

    Examples:
        >>> run = run_scene("fig4", "verlet", {"striker.speed": "1 m/s"}, runs=folder)
        >>> run.record.status, run.trace.force_N.shape
        ('done', (801, 22))
    """
    if time_limit_s is not None and not 0 < time_limit_s < float("inf"):
        raise InputError("run_scene", "time_limit_s", str(time_limit_s), "seconds above zero")
    if not isinstance(scene, Case):
        scene = build_case(read_scene(scene, setting_texts(settings or {})))
    elif settings:
        raise InputError("run_scene", "settings", "settings for a planned case", "settings given to validation.plan")
    refuse(scene, engine)
    run = run_case(scene, engine, Path(runs or paths.RUNS), rerun=rerun, limit_s=time_limit_s)
    if not run.done:
        raise RunError(f"{paths.shown(run.folder)}: {run.record.status}: {run.record.reason}", run.record.status)
    return run


def open_run(name: str | Path, runs: str | Path | None = None) -> EndedRun:
    """Open a finished run by its folder, or the newest done run of a scene by ``ENGINE:SCENE``.

    Args:
        name: Path of a run folder, or for example ``"yade:fig4"``: the newest done run of the scene as its file is
            now; without a file of this name, the newest done run recorded under it.
        runs: Folder of the run folders; by default ``runs/`` of the checkout.

    Returns:
        EndedRun: The run, as ``run_scene`` returns it.

    Raises:
        InputError: There is no such run (the message says how to make it), the run is not done, or its record is
            damaged.

    Examples:
        >>> open_run("verlet:fig4", runs=folder).record.engine
        'verlet'
    """
    return open_folder(run_folder(name, Path(runs or paths.RUNS)))


class LivePage:
    """Live page of a scene, which a notebook shows as the last value of a cell.

    Attributes:
        address: Address of the page, on this machine.
    """

    def __init__(self, *words: str) -> None:
        command = (str(Path(sys.executable).with_name("beads")), "explore", *words, "--no-browser")
        self._launched = start(command, Path.cwd(), {**os.environ}, stdout=subprocess.PIPE)
        assert self._launched[0].stdout is not None
        self.address = self._launched[0].stdout.readline().decode().strip()
        if not self.address:
            self.close()
            raise RunError("the page did not start; the reason stands in the output of this process")

    def _repr_html_(self) -> str:
        return f'<iframe src="{escape(self.address)}" width="100%" height="{PAGE_PX}" style="border: 0"></iframe>'

    def close(self) -> None:
        """End the page and its work; the end of this process does so, too."""
        end(*self._launched)


def explore(scene: str | Path, settings: Mapping[str, Any] | None = None, *, knobs: Sequence[str] = ()) -> LivePage:
    """Live page of a scene, as by the command ``beads explore``, shown in a notebook on the same machine.

    Args:
        scene: Name of a scene in ``inputs/scenes``, or path of a scene file.
        settings: Values that replace those of the scene file, as for ``run_scene``.
        knobs: Ranges of knobs, such as ``"striker.speed=0.1..5"``.

    Raises:
        InputError: The scene or a setting is wrong.
        RunError: The page does not start, for instance because of a knob.

    Examples:
        >>> page = explore("fig4", {"striker.speed": 1.0})
        >>> page.address.startswith("http://127.0.0.1:")
        True
        >>> page.close()
    """
    texts = setting_texts(settings or {})
    read_scene(scene, texts)
    options = (("--set", text) for text in texts), (("--knob", text) for text in knobs)
    return LivePage(str(scene), *(word for each in options for pair in each for word in pair))
