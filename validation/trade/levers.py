"""Levers of the trade study: other ways to save time or error, each with its effect."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import nan, sqrt
from pathlib import Path
from statistics import median

from drivers.base.decks import Deck
from drivers.base.errors import RunError
from drivers.base.processes import run_command
from drivers.base.progress import following
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.engines import Engine, installed_codes, load_engine
from drivers.limits.criteria import rayleigh_time
from drivers.run.run import default_limit_s
from postproc.paper.simulate import case_of, exact
from postproc.read.observables import of_kind
from postproc.read.residual import residual
from validation.accuracy.exact_motion import errors_of, exact_motion_of, quantities
from validation.served_runs import builds_of, left_out_if_failed, serve, serving
from validation.trade.ladder import start_up

PAIR_STEPS_US = (1.0, 0.5, 0.2, 0.1, 0.05)
SOFTENING_FACTORS = (10, 100, 1000)
FRACTIONS = (0.1, 0.2, 0.4)
CASES_PER_PROCESS = 10
ON_TWO_CORES = ("fig4", "long-chain")
TWO_CORES_FOR = "run.duration=0.5 ms"  # some hundred steps suffice for a ratio


@dataclass(frozen=True)
class Lever:
    """One measurement of a lever.

    Attributes:
        error: error of the quantity, as in ``accuracy.exact_motion``; NaN if the lever changes only the cost.
        gain: cost without the lever over cost with it; NaN if the lever changes only the error.
    """

    lever: str
    scene: str
    engine: str
    setting: str
    quantity: str
    error: float = nan
    gain: float = nan


def measure_levers(*, short: bool = False) -> Iterator[Lever]:
    """Measures all levers; the short study omits higher precision (20 times as slow) and the long chain."""
    in_repo, shared = (
        (sampling, extrapolation, rayleigh, softened),
        partial(two_cores, ON_TWO_CORES[: 1 if short else 2]),
    )
    levers: tuple[Callable[[], Iterator[Lever]], ...] = (*in_repo, shared, *[precision] * (not short), one_process)
    for lever in following(levers, "levers", len(levers), "lever"):
        yield from lever()


def sampling() -> Iterator[Lever]:
    """Errors of peaks and arrivals of the exact motion when read from samples at several intervals."""
    fine = exact_motion_of(case_of("fig4"))
    for interval in ("0.5 us", "1 us", "2 us", "5 us", "10 us"):
        case = case_of("fig4", f"run.sample_interval={interval}", "run.time_step=0.1 us")
        seen = quantities(case, exact(case, 1e-12).trace)
        for name in ("bead_5_peak", "wall_peak", "wall_arrival", "speed_9_to_5"):
            error = abs(seen[name] / fine.true[name] - 1)
            yield Lever("sampling interval", "fig4", "any", interval, name, error)


def extrapolation() -> Iterator[Lever]:
    """Richardson's ``(4 F(dt/2) - F(dt)) / 3`` from two runs: its error and the steps saved."""
    for scene in ("fig4", "fig5", "steel-chain"):
        case = case_of(scene)
        exact_motion = exact_motion_of(case)
        for step_us in PAIR_STEPS_US:
            every = round(case.scene.run.sample_interval / step_us * 1e6)
            coarse, fine = verlet_of(case.at(every)), verlet_of(case.at(2 * every))
            both = replace(fine, force_N=(4 * fine.force_N - coarse.force_N) / 3)
            error = errors_of(case, both, exact_motion, ("force",))["force"]
            alone = errors_of(case, fine, exact_motion, ("force",))["force"]
            steps_alone = 2 * every * sqrt(alone / error)  # with the same error, by order 2
            setting = f"{step_us:g} us and half of it"
            yield Lever("Richardson extrapolation", scene, "verlet", setting, "force", error, steps_alone / (3 * every))


def rayleigh() -> Iterator[Lever]:
    """Errors at fractions of the Rayleigh time."""
    for scene in ("fig4", "fig5", "fig6b", "fig6d", "low-amplitude", "steel-chain"):
        base = case_of(scene)
        for fraction in FRACTIONS:
            step = fraction * rayleigh_time(base)
            case = base.sampled_at_every(step)
            exact_motion = exact_motion_of(case)
            true = exact_motion.true
            names = ["force", *(name for name in of_kind(true, "peak", "speed") if not name.startswith("bead"))]
            for name, error in errors_of(case, verlet_of(case), exact_motion, names).items():
                yield Lever("Rayleigh fraction", scene, "any", f"{fraction:g} of it", name, error)


def softened() -> Iterator[Lever]:
    """Errors of V_s and F_m on softened beads, scaled back by E^(2/5); the gain is that of the larger time step.

    Without gravity, with a rigid wall and one material, the chain is similar: at a given striker speed times are
    proportional to E^(-2/5), forces to E^(2/5).
    """
    for gravity in ("", "9.81 m/s^2"):
        base = ("wall.material=rigid", f"gravity={gravity}")
        hard = quantities(case := case_of("fig4", *base), exact(case, 1e-11).trace)
        for softer in SOFTENING_FACTORS:
            longer = softer**0.4
            case = case_of(
                "fig4", *base, f"materials.ptfe.youngs_modulus={1.46e9 / softer} Pa",
                f"run.duration={0.8 * longer} ms", f"run.sample_interval={longer} us",
                f"run.time_step={longer / 10} us",
            )  # fmt: skip
            soft = quantities(case, exact(case, 1e-11).trace)
            where = "with gravity" if gravity else "without gravity"
            for name in ("speed_9_to_5", "bead_5_amplitude", "wall_amplitude"):
                error = abs(soft[name] * longer / hard[name] - 1)
                yield Lever("softened modulus", "fig4", "any", f"E/{softer}, {where}", name, error, longer)


def two_cores(scenes: Sequence[str] = ON_TWO_CORES) -> Iterator[Lever]:
    """Speed-up of the loop by a second core."""
    pairs = [*product(scenes, installed_codes())]
    for scene, name in following(pairs, "two cores", len(pairs)):
        case, engine = case_of(scene, "run.time_step=1 us", TWO_CORES_FOR), load_engine(name)
        if engine.on_two_cores and len(engine.find() or ()) == 1:  # the command does not set the number of cores
            with left_out_if_failed(f"{name}, two cores"):
                deck = engine.render(case)
                one, two = (_loop_s(case, engine, each) for each in (deck, engine.on_two_cores(deck)))
                yield Lever("two cores", scene, name, "2 cores", "loop", gain=one / two)


def _loop_s(case: Case, engine: Engine, deck: Deck) -> float:
    """Time of the loop in a process for this run alone, in s; RunError if it failed."""
    command = engine.find()
    assert command is not None
    with tempfile.TemporaryDirectory() as folder:
        deck.write(Path(folder))
        run_command(engine.started(deck, command), Path(folder), default_limit_s(case, engine), **engine.environment)
        stdout, stderr = (Path(folder, f"{name}.txt").read_text(errors="replace") for name in ("stdout", "stderr"))
    loop_s = engine.loop_seconds(stdout)
    if not loop_s:
        raise RunError(engine.failure_reason(stdout, stderr))
    return loop_s


def precision() -> Iterator[Lever]:
    """Rounding error of absolute heights in builds of higher precision, with the wall at 0 and at 1 km."""
    for name, (origin, wall) in product(installed_codes(), (("0 m", "wall at height 0"), ("1 km", "wall at 1 km"))):
        case = case_of("fig4", f"chain.origin={origin}", "run.time_step=0.1 us", "run.sample_interval=2 us")
        builds = builds_of(name)
        double_s = nan
        for build in builds if len(builds) > 1 else ():
            with left_out_if_failed(f"{build or name}, {wall}"), serving(name, build) as session:
                run = serve(session, case)
                double_s = double_s if build else run.loop_s
                error = float(residual(run.trace, verlet_of(case)).max())
                yield Lever("extended precision", "fig4", build or name, wall, "rounding", error, double_s / run.loop_s)


def one_process() -> Iterator[Lever]:
    """Speed-up by many cases in one process, over one process per case."""
    case = case_of("fig4")
    for name in installed_codes():
        with left_out_if_failed(f"one process of {name} for many"), serving(name) as session:
            alone = start_up(case, name)
            runs = [serve(session, case) for _ in range(CASES_PER_PROCESS)]
            loop_s, case_s = median(run.loop_s for run in runs), median(run.case_s for run in runs)
            yield Lever(
                "one process for many",
                "fig4",
                name,
                f"{CASES_PER_PROCESS} cases",
                "run",
                gain=(alone + loop_s) / case_s,
            )
