"""Extreme scenes on all engines: checks of each run, or the reason why there is none."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.terminal import following
from drivers.engines import REFERENCE, VERLET, codes, installed
from drivers.limits import refuse
from drivers.run.run import run_many
from drivers.scene.model import Part
from drivers.scene.read_scene import read_entries
from validation.accuracy.budget import ERROR, assess, kept_budget
from validation.accuracy.plan import planned_case
from validation.checks import FAIL, NOT_RUN, Check, without_run

NOT_ACCURATE = "not accurate"


class Extreme(Part):
    """Extreme scene of ``inputs/extremes.toml``.

    Attributes:
        set: settings over the scene, in the form of ``--set``.
        quick: True if the scene is in the subset of the tests and of the short study.
    """

    name: str
    scene: str
    set: tuple[str, ...] = Field(default=(), strict=False)
    quick: bool = False


def extremes(*, quick: bool = False) -> list[Extreme]:
    """Scenes of ``inputs/extremes.toml``, or the quick subset."""
    entries = read_entries(paths.INPUTS / "extremes.toml", "extreme", Extreme)
    return [entry for entry in entries if entry.quick or not quick]


def run_all(chosen: list[Extreme], runs: Path) -> Iterator[Check]:
    """Checks of extreme scenes on every engine, one scene after the other; finished runs are reused.

    A refused scene counts as not run. At the edge many runs are right, but not accurate: an error above the general
    ceiling is no failure here, but ``NOT_ACCURATE``.
    """
    names = (REFERENCE, VERLET, *codes())
    cases = {extreme.name: planned_case(extreme.scene, *extreme.set) for extreme in chosen}
    absent: dict[tuple[str, str], str] = {}
    for extreme, case in cases.items():
        for engine in names:
            if engine not in installed(names):
                absent[extreme, engine] = "not installed"
                continue
            try:
                refuse(case, engine)
            except InputError as refusal:
                absent[extreme, engine] = f"refused: {refusal}"
    jobs = [(extreme, engine) for extreme in cases for engine in names if (extreme, engine) not in absent]
    ended = run_many([(cases[extreme], engine) for extreme, engine in jobs], runs, unsafe=True)
    by_job = dict(zip(jobs, ended, strict=True))
    for extreme, case in following(cases.items(), "extreme scenes, assessed", len(cases), "scene"):
        for engine in names:
            if why := absent.get((extreme, engine)):
                yield without_run(extreme, engine, why, NOT_RUN)
                continue
            run = assess(by_job[extreme, engine], case)
            if run.done:
                for check in kept_budget(case, run).checks:
                    inaccurate = check.verdict == FAIL and check.quantity.startswith(ERROR)
                    yield replace(check, scene=extreme, verdict=NOT_ACCURATE if inaccurate else check.verdict)
            else:
                yield without_run(extreme, engine, f"{run.record.status}: {run.record.reason}", FAIL)
