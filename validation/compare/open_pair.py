"""Two run folders, read and brought to the sample times that they share."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.batch.store import ENDING
from drivers.chain.case import Case
from drivers.chain.elements import choose_elements
from drivers.chain.trace import Trace, part_of
from drivers.engines import engine_names
from drivers.run.finished import FILE, EndedRun, open_run
from postproc.read.motion import chain_of

MIN_SAMPLES = 4  # of which peaks can be read
TIME_TOLERANCE = 1e-9  # of a sample time


@dataclass(frozen=True)
class PairedRun:
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


def open_pair(first: Path, second: Path) -> tuple[PairedRun, PairedRun]:
    """Two runs at their common sample times.

    Raises:
        InputError: one is no run that is done, both are the same, or they have other contacts or sample times.
    """
    where = f"{paths.shown(first)} {paths.shown(second)}"
    if first.resolve() == second.resolve():
        raise InputError(where, "", "the same run twice", "two run folders")
    one, other = _open(first), _open(second)
    counts = [run.trace.force_N.shape[1] for run in (one, other)]
    if counts[0] != counts[1]:
        raise InputError(where, "", f"{counts[0]} contacts against {counts[1]}", "runs of as many contacts")
    every, samples = _common(where, one.trace, other.trace)
    if samples < MIN_SAMPLES:
        raise InputError(where, "", f"{samples} common sample times", f"{MIN_SAMPLES} or more")
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


def _common(where: str, *traces: Trace) -> tuple[list[int], int]:
    """How many samples of each run make one of the common ones, and how many of these there are."""
    times = [trace.time_s for trace in traces]
    intervals = [float(time[1] - time[0]) if len(time) > 1 else float("nan") for time in times]
    if np.isfinite(intervals).all():
        every = [round(max(intervals) / interval) for interval in intervals]
        thinned = [time[::each] for time, each in zip(times, every, strict=True)]
        samples = min(len(time) for time in thinned)
        whole = every == [1, 1] or samples == len(times[every.index(1)])  # all samples of the coarser run
        if whole and np.allclose(thinned[0][:samples], thinned[1][:samples], rtol=TIME_TOLERANCE, atol=0):
            return every, samples
    found = (f"samples each {each:g} s until {time[-1]:g} s" for each, time in zip(intervals, times, strict=True))
    common = "sample times of one run that the other has as well"
    raise InputError(where, "run.sample_interval", " against ".join(found), common)


def _at_every(run: EndedRun, every: int, samples: int) -> PairedRun:
    """A run at each so many-th of its samples."""
    scene, chain = chain_of(run)
    if (every, samples) != (1, scene.samples):
        timing = scene.run.model_copy(update={"sample_interval": every * scene.run.sample_interval})
        changes = {"run": timing, "steps_per_sample": every * scene.steps_per_sample, "samples": samples}
        scene = scene.model_copy(update=changes)
    trace = part_of(run.trace, slice(0, every * samples, every))
    return PairedRun(run, Case(scene, chain, choose_elements(scene, chain)), trace)
