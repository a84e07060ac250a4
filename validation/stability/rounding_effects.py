"""Effects of rounding: on forces at rest, on the energy over ten million steps, on the horizon of two codes.

Forces at rest are compared with the exact ones: at time 0 the chain is in equilibrium under the load on its top bead.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from drivers.base.terminal import following
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.schemes import verlet_in_heights, verlet_of
from drivers.chain.trace import Trace, largest_kinetic_J, parted_s
from drivers.engines import REFERENCE, VERLET, installed_codes
from drivers.run.compute import compute
from drivers.run.execute import execute
from postproc.paper.simulate import case_of
from validation.chapters import left_out_if_failed

# five beads that bounce under gravity, and five that are pressed together so that no contact opens
FIVE_BEADS = (
    "chain.count=5",
    "chain.sensors=[]",
    "run.sample_interval=1 ms",
    "run.time_step=1 us",
    "run.duration=10 s",
)
LOADED = ("chain.precompression=30 N", "striker=", "chain.bead=[{from_wall=5, velocity='-2 cm/s'}]")
LONG_RUNS = {"beads that bounce": FIVE_BEADS, "contacts that stay closed": (*FIVE_BEADS, *LOADED)}
BOUNCING = "fig4"
HORIZON_STEPS_US = (2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02)
HORIZON = ("run.duration=30 ms", "run.sample_interval=10 us")
AGREEMENT = 1e-2  # of the largest change
BLOCKS = 20  # of a run, for standard errors
SIGNIFICANCE = 3.0  # standard errors of a drift
HEIGHTS_M = (0.0, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5)
LOADS_N = tuple(10.0 ** np.arange(-8.0, 3.0, 2.0))
BEADS = 3
OVERLAPS, HEIGHTS = "in-repo, overlaps", "in-repo, heights"


@dataclass(frozen=True)
class Energy:
    """Energy error of a long run, divided by the largest kinetic energy.

    Attributes:
        largest: largest error of all samples.
        drift, drift_error: drift over the whole run, from the mean energies of its blocks, and its standard error.
        walk: standard deviation of the change between neighbouring blocks; a random walk has it without a drift.
    """

    scene: str
    method: str
    steps: int
    largest: float
    drift: float
    drift_error: float
    walk: float


@dataclass(frozen=True)
class Horizon:
    """Time in s at which two methods first differ by 1 % of the largest change; NaN if they never do."""

    time_step_s: float
    one: str
    other: str
    until_s: float
    duration_s: float


def energies() -> Iterator[Energy]:
    """Energy errors of all engines over ten million steps."""
    for name, settings in following(LONG_RUNS.items(), "long runs", len(LONG_RUNS)):
        case = case_of("fig4", *settings)
        for engine, trace in _by_all(case).items():
            yield energy_of(name, engine, case, trace)


def horizons() -> Iterator[Horizon]:
    """Horizons of pairs of methods, by time step."""
    names = installed_codes()
    for step in following(HORIZON_STEPS_US, "time steps", len(HORIZON_STEPS_US), "step"):
        case = case_of(BOUNCING, *HORIZON, f"run.time_step={step} us")
        traces = _by_all(case)
        for one, other in (*combinations(names, 2), *((name, VERLET) for name in names), (VERLET, REFERENCE)):
            until_s = parted_s(traces[one], traces[other], AGREEMENT)
            yield Horizon(case.scene.time_step_s, one, other, until_s, float(case.sample_times_s[-1]))


def _by_all(case: Case) -> dict[str, Trace]:
    """Traces of a case by the in-repo engines and by every installed code, in parallel."""
    engines = [VERLET, REFERENCE, *installed_codes()]
    traces = dict(execute(lambda name: compute(case, name).done, engines))
    return {name: traces[name] for name in engines}


def energy_of(scene: str, method: str, case: Case, trace: Trace) -> Energy:
    """Largest energy error of a trace, and its drift from the means of its blocks."""
    signed = (trace.total_energy_J - trace.total_energy_J[0]) / largest_kinetic_J(case.chain, trace)
    levels = np.array([part.mean() for part in np.array_split(signed, BLOCKS)])
    steps = np.diff(levels)
    walk, count = float(steps.std(ddof=1)), len(steps)
    drift, error = float(levels[-1] - levels[0]) * BLOCKS / count, walk * np.sqrt(count) * BLOCKS / count
    return Energy(scene, method, case.scene.steps, float(np.abs(signed).max()), drift, float(error), walk)


@dataclass(frozen=True)
class Rounded:
    """Largest relative error of the forces between beads at time 0.

    Attributes:
        method: a code, or the in-repo scheme in overlaps or in heights.
        height_m: height of the wall.
        overlap_m: overlap of the contacts.
    """

    method: str
    height_m: float
    overlap_m: float
    error: float


def measure_rounding() -> Iterator[Rounded]:
    """Errors against height and overlap."""
    cases = [pressed(load, height) for height in HEIGHTS_M for load in LOADS_N]
    for case in cases:
        yield rounded(case, OVERLAPS, verlet_of(case).force_N)
        yield rounded(case, HEIGHTS, verlet_in_heights(case).force_N)
    for engine in following(codes := installed_codes(), "rounding by codes", len(codes), "code"):
        with left_out_if_failed(engine):
            yield from [rounded(case, engine, compute(case, engine).done.force_N) for case in cases]


def pressed(load_N: float, height_m: float) -> Case:
    """Short chain at rest, pressed from above."""
    rest = ("striker=", "gravity=", "chain.sensors=[]", "run.duration=1 ns", "run.sample_interval=1 ns")
    settings = (f"chain.count={BEADS}", f"chain.precompression={load_N:g} N", f"chain.origin={height_m:g} m")
    return case_of("fig4", *settings, *rest, "run.time_step=1 ns")


def rounded(case: Case, method: str, force_N: Array) -> Rounded:
    """Rounding error of the forces of a method at time 0, of shape (samples, bodies)."""
    chain = case.chain
    error = np.abs(force_N[0] / chain.force_N - 1)[1:]
    return Rounded(method, chain.wall_height_m, float(chain.overlap_m[1]), float(error.max()))
