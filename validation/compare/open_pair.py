"""Two run folders, opened and brought to the sample times that they share."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import sha256_of
from drivers.batch.store import ENDING
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.elements import choose_elements
from drivers.chain.trace import FORCES, Trace, part_of
from drivers.engines import engine_names
from drivers.run.finished import EndedRun, open_run
from drivers.run.record import FILE
from postproc.read.motion import chain_of

LEAST_SAMPLES = 4  # of which peaks can be read
SAME_TIME = 1e-9  # of an interval


@dataclass(frozen=True)
class Opened:
    """A run as it takes part in a comparison.

    Attributes:
        case: of the run's own scene, at the samples that both runs have.
        trace: likewise.
    """

    run: EndedRun
    case: Case
    trace: Trace

    @property
    def engine(self) -> str:
        """The engine that ran it."""
        return self.run.record.engine


def open_pair(first: Path, second: Path) -> tuple[Opened, Opened]:
    """Two runs at their common sample times.

    Raises:
        InputError: one is no run that is done, both are the same, or they have other contacts or sample times.
    """
    if first.resolve() == second.resolve():
        raise InputError(f"{paths.shown(first)} {paths.shown(second)}", "", "the same run twice", "two run folders")
    one, other = _open(first), _open(second)
    where = f"{paths.shown(first)} {paths.shown(second)}"
    counts = [run.trace.force_N.shape[1] for run in (one, other)]
    if counts[0] != counts[1]:
        raise InputError(where, "", f"{counts[0]} contacts against {counts[1]}", "runs of as many contacts")
    every, samples = _common(where, one.trace, other.trace)
    if samples < LEAST_SAMPLES:
        raise InputError(where, "", f"{samples} common sample times", f"{LEAST_SAMPLES} or more")
    return _at_every(one, every[0], samples), _at_every(other, every[1], samples)


def _open(folder: Path) -> EndedRun:
    if not (folder / FILE).exists():
        if next(folder.glob(f"*{ENDING}"), None) or next(folder.glob(f"batch/*{ENDING}"), None):
            lay_out = "run folders (python -m drivers show STUDY CASE lays a case out as one)"
            raise InputError(paths.shown(folder), "", "the store of a batch", lay_out)
        if next(folder.glob(f"*/{FILE}"), None):
            raise InputError(paths.shown(folder), "", "a folder of runs", "one of the run folders in it")
    run = open_run(folder)
    if run.record.engine not in engine_names():
        raise InputError(paths.shown(folder / FILE), "engine", run.record.engine, f"one of {', '.join(engine_names())}")
    return run


def _common(where: str, one: Trace, other: Trace) -> tuple[tuple[int, int], int]:
    """How many samples of each run make one of the common ones, and how many of these there are."""
    first, second = one.time_s, other.time_s
    if min(len(first), len(second)) > 1:
        ratio = float((second[1] - second[0]) / (first[1] - first[0]))
        coarser = max(ratio, 1 / ratio)
        every = (round(coarser), 1) if ratio > 1 else (1, round(coarser))
        thinned = [times[::each] for times, each in zip((first, second), every, strict=True)]
        samples = min(len(times) for times in thinned)
        last = (first, second)[1 if ratio > 1 else 0] if every != (1, 1) else thinned[0][:samples]
        close = np.allclose(thinned[0][:samples], thinned[1][:samples], rtol=SAME_TIME, atol=0)
        if close and samples == len(last):
            return every, samples
    found = " against ".join(f"samples each {_interval(t):g} s until {t[-1]:g} s" for t in (first, second))
    raise InputError(where, "run.sample_interval", found, "sample times of one run that the other has as well")


def _interval(time_s: Array) -> float:
    return float(time_s[1] - time_s[0]) if len(time_s) > 1 else float("nan")


def _at_every(run: EndedRun, every: int, samples: int) -> Opened:
    """A run at each so many-th of its samples."""
    scene, chain = chain_of(run)
    timing = scene.run.model_copy(update={"sample_interval": every * scene.run.sample_interval})
    changes = {"run": timing, "steps_per_sample": every * scene.steps_per_sample, "samples": samples}
    if (every, samples) != (1, scene.samples):
        scene = scene.model_copy(update=changes)
    trace = part_of(run.trace, slice(0, every * samples, every))
    return Opened(run, Case(scene, chain, choose_elements(scene, chain)), trace)


def changed_since(run: EndedRun) -> bool:
    """Whether the forces are no longer those that the record was written for."""
    return sha256_of(run.folder / FORCES) != run.record.forces_sha256
