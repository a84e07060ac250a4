"""What absolute heights cost: the error of a contact's force at time 0, by position, overlap and number of beads.

At time 0 the exact force is known: the chain rests in equilibrium under the load on its top bead.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.engines import installed_codes, load_engine
from postproc.paper.simulate import case_of
from validation.accuracy.schemes import verlet_in_heights, verlet_of
from validation.served_runs import builds_of, left_out_if_failed, serve, serving
from validation.studies import progress

HEIGHTS_M = (0.0, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5)
LOADS_N = tuple(10.0 ** np.arange(-8.0, 3.0, 2.0))
COUNTS = (10, 100, 1000, 10_000, 100_000)
COUNTS_LOAD_N = 1.0
OVERLAPS, HEIGHTS = "in-repo, overlaps", "in-repo, heights"


@dataclass(frozen=True)
class Rounded:
    """The largest relative error of the forces between beads at time 0.

    Attributes:
        method: an engine, a build of its code in higher precision, or the in-repo scheme in overlaps or in heights.
        height_m: of the wall.
        overlap_m: of the contacts.
    """

    method: str
    beads: int
    height_m: float
    overlap_m: float
    error: float


def measure_rounding() -> Iterator[Rounded]:
    """Errors by height and overlap, then by the number of beads."""
    cases = [pressed(3, load, height) for height in HEIGHTS_M for load in LOADS_N]
    cases += [pressed(count, COUNTS_LOAD_N, 0.0) for count in COUNTS]
    for case in cases:
        yield from in_repo(case)
    for engine in installed_codes():
        for build in builds_of(engine):
            progress(f"rounding of heights: {build or engine}")
            with left_out_if_failed(build or engine):
                yield from list(by_build(engine, build, cases))


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
    """By a code, or a build of it; the longest chains only where they take seconds."""
    most_bodies = load_engine(engine).precise_builds.get(build, inf)
    with serving(engine, build) as session:
        for case in cases:
            if case.chain.bodies <= most_bodies:
                yield _rounded(case, build or engine, serve(session, case).trace.force_N)


def _rounded(case: Case, method: str, force_N: Array) -> Rounded:
    chain = case.chain
    error = np.abs(force_N[0] / chain.force_N - 1)[1:]
    return Rounded(method, chain.beads, chain.wall_height_m, float(chain.overlap_m[1]), float(error.max()))
