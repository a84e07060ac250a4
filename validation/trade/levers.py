"""What users do besides choosing a step: each lever's error and its cost, measured."""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from math import nan, sqrt
from pathlib import Path
from statistics import median

from drivers.base.decks import Deck
from drivers.base.processes import run_command
from drivers.chain.case import Case
from drivers.engines import Engine, installed_codes, load_engine
from drivers.limits.criteria import rayleigh_time
from drivers.run.run import default_limit_s
from postproc.paper.simulate import case_of, exact
from postproc.read.observables import of_kind
from postproc.read.residual import residual
from validation.accuracy.schemes import errors_of, quantities, truth_of, verlet_of
from validation.served_runs import builds_of, left_out_if_failed, serve, serving
from validation.trade.climb import start_up

PAIR_STEPS_US = (1.0, 0.5, 0.2, 0.1, 0.05)
SOFTER = (10, 100, 1000)
FRACTIONS = (0.1, 0.2, 0.4)
MANY = 20


@dataclass(frozen=True)
class Lever:
    """One measurement of a lever.

    Attributes:
        error: of the quantity, as in ``accuracy.schemes``; NaN where the lever changes only the cost.
        gain: how many times cheaper (below 1: dearer) than without the lever; NaN where it is not about cost.
    """

    lever: str
    scene: str
    engine: str
    setting: str
    quantity: str
    error: float = nan
    gain: float = nan


def pull_all() -> Iterator[Lever]:
    """Every lever."""
    for lever in (sampling, extrapolation, rayleigh, softened, two_cores, precision, one_process):
        yield from lever()


def sampling() -> Iterator[Lever]:
    """Peaks and arrivals read from samples so far apart, of the exact motion."""
    fine = truth_of(case_of("fig4"))
    for interval in ("0.5 us", "1 us", "2 us", "5 us", "10 us"):
        case = case_of("fig4", f"run.sample_interval={interval}", "run.time_step=0.1 us")
        seen = quantities(case, exact(case, 1e-12).trace)
        for name in ("bead_5_peak", "wall_peak", "wall_arrival", "speed_9_to_5"):
            error = abs(seen[name] / fine.true[name] - 1)
            yield Lever("sampling interval", "fig4", "any", interval, name, error)


def extrapolation() -> Iterator[Lever]:
    """Richardson's ``(4 F(dt/2) - F(dt)) / 3`` from two runs: the error, and the steps it saves."""
    for scene in ("fig4", "fig5", "steel-chain"):
        case = case_of(scene)
        truth = truth_of(case)
        for step_us in PAIR_STEPS_US:
            every = round(case.scene.run.sample_interval / step_us * 1e6)
            coarse, fine = verlet_of(case.at(every)), verlet_of(case.at(2 * every))
            both = replace(fine, force_N=(4 * fine.force_N - coarse.force_N) / 3)
            error = errors_of(case, both, truth, ("force",))["force"]
            alone = errors_of(case, fine, truth, ("force",))["force"]
            steps_alone = 2 * every * sqrt(alone / error)  # of second order, for the same error
            setting = f"{step_us:g} us and half of it"
            yield Lever("Richardson extrapolation", scene, "verlet", setting, "force", error, steps_alone / (3 * every))


def rayleigh() -> Iterator[Lever]:
    """What a fraction of the Rayleigh time means in error."""
    for scene in ("fig4", "fig5", "fig6b", "fig6d", "low-amplitude", "steel-chain"):
        base = case_of(scene)
        for fraction in FRACTIONS:
            step = fraction * rayleigh_time(base)
            case = base.sampled_at_every(step)
            truth = truth_of(case)
            names = ["force", *(name for name in of_kind(truth.true, "peak", "speed") if not name.startswith("bead"))]
            for name, error in errors_of(case, verlet_of(case), truth, names).items():
                yield Lever("Rayleigh fraction", scene, "any", f"{fraction:g} of it", name, error)


def softened() -> Iterator[Lever]:
    """Softer contacts allow larger steps: what is left of V_s and F_m once scaled back by E^(2/5).

    Without gravity the chain is similar: times go with E^(-2/5) at a given striker speed, forces with E^(2/5).
    The gain is that of the step. Only a rigid wall and one material keep the scene similar otherwise.
    """
    for gravity in ("", "9.81 m/s^2"):
        base = ("wall.material=rigid", f"gravity={gravity}")
        hard = quantities(case := case_of("fig4", *base), exact(case, 1e-11).trace)
        for softer in SOFTER:
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


def two_cores() -> Iterator[Lever]:
    """The same run on two cores: how much faster its loop is."""
    for scene, name in product(("fig4", "long-chain"), installed_codes()):
        case, engine = case_of(scene, "run.time_step=1 us"), load_engine(name)
        if engine.on_two_cores:
            deck = engine.render(case)
            one, two = (_loop_s(case, engine, each) for each in (deck, engine.on_two_cores(deck)))
            if one and two:
                yield Lever("two cores", scene, name, "2 cores", "loop", gain=one / two)


def _loop_s(case: Case, engine: Engine, deck: Deck) -> float | None:
    """Seconds in the loop of a process by itself; None where it failed."""
    executable = engine.find()
    assert executable is not None
    with tempfile.TemporaryDirectory() as folder:
        deck.write(Path(folder))
        run_command(deck.command_with(executable), Path(folder), default_limit_s(case), **engine.variables)
        return engine.loop_seconds(Path(folder, "stdout.txt").read_text(errors="replace"))


def precision() -> Iterator[Lever]:
    """What builds of higher precision leave of the rounding of heights, also a kilometre up."""
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
    """Many cases in one process against a process each."""
    case = case_of("fig4")
    for name in installed_codes():
        with left_out_if_failed(f"one process of {name} for many"), serving(name) as session:
            alone = start_up(name, case)
            runs = [serve(session, case) for _ in range(MANY)]
            loop_s, case_s = median(run.loop_s for run in runs), median(run.case_s for run in runs)
            yield Lever("one process for many", "fig4", name, f"{MANY} cases", "run", gain=(alone + loop_s) / case_s)
