"""What absolute heights cost: the error of a contact's force at time 0, by position, overlap and number of beads.

At time 0 the exact force is known: the chain rests in equilibrium under the load on its top bead.
"""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.engines import load_engine
from drivers.run.guard import checked_trace
from drivers.run.run import default_limit_s
from drivers.run.session import Session
from postproc.paper.simulate import case_of
from validation.accuracy.error_measures import verlet_of
from validation.accuracy.rounding import verlet_in_heights

HEIGHTS_M = (0.0, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5)
LOADS_N = tuple(10.0 ** np.arange(-8.0, 3.0, 2.0))
COUNTS = (10, 100, 1000, 10_000, 100_000)
COUNTS_LOAD_N = 1.0
BUILDS = {"yade": ("yade", "yade-longdouble", "yade-float128"), "liggghts": ("liggghts",)}
MOST_BEADS = {"yade-longdouble": 10_000, "yade-float128": 1000}  # builds that take long
OVERLAPS, HEIGHTS = "in-repo, overlaps", "in-repo, heights"


@dataclass(frozen=True)
class Rounded:
    """The largest relative error of the forces between beads at time 0.

    Attributes:
        method: an engine's build, or the in-repo scheme in overlaps or in heights.
        height_m: of the wall.
        overlap_m: of the contacts.
    """

    method: str
    beads: int
    height_m: float
    overlap_m: float
    error: float


def measure(say: Callable[[str], object] = print) -> list[Rounded]:
    """Errors by height and overlap, then by the number of beads."""
    cases = [pressed(3, load, height) for height in HEIGHTS_M for load in LOADS_N]
    cases += [pressed(count, COUNTS_LOAD_N, 0.0) for count in COUNTS]
    found = [each for case in cases for each in in_repo(case)]
    for engine, builds in BUILDS.items():
        for build in builds:
            found += by_build(engine, build, cases)
    say(f"rounding of heights: {len(found)} forces")
    return found


def pressed(count: int, load_N: float, height_m: float) -> Case:
    """A chain at rest, pressed together from above; its forces at time 0 are known."""
    rest = ("striker=", "gravity=", "chain.sensors=[]", "run.duration=1 ns", "run.sample_interval=1 ns")
    settings = (f"chain.count={count}", f"chain.precompression={load_N:g} N", f"chain.origin={height_m:g} m")
    return case_of("fig4", *settings, *rest, "run.time_step=1 ns")


def in_repo(case: Case) -> Iterator[Rounded]:
    """By the scheme of the codes in overlaps and in heights."""
    yield _rounded(case, OVERLAPS, verlet_of(case).force_N)
    yield _rounded(case, HEIGHTS, verlet_in_heights(case).force_N)


def by_build(engine: str, build: str, cases: list[Case]) -> Iterator[Rounded]:
    """By a build of a code, where it is installed; the longest chains only by those that do not take long."""
    module = load_engine(engine)
    usual = module.find()
    executable = usual.with_name(build) if usual else None
    if executable is None or not executable.exists():
        return
    with tempfile.TemporaryDirectory() as folder:
        session = Session(module, executable, Path(folder))
        try:
            for case in cases:
                if case.chain.bodies <= MOST_BEADS.get(build, case.chain.bodies):
                    outcome = session.run(module.render(case), default_limit_s(case))
                    yield _rounded(case, build, checked_trace(case, module, outcome, session.case).force_N)
        finally:
            session.close()


def _rounded(case: Case, method: str, force_N: Array) -> Rounded:
    chain = case.chain
    error = np.abs(force_N[0] / chain.force_N - 1)[1:]
    return Rounded(method, chain.beads, chain.wall_height_m, float(chain.overlap_m[1]), float(error.max()))
