"""What is measured: errors against time on a ladder of steps within a budget, and what else users do.

The ladder leads from the stability limit down to 1e-4 of it; each lever has its error and its cost.
"""

import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, product
from math import ceil, nan, sqrt
from pathlib import Path
from statistics import median
from threading import Lock
from typing import Any

import numpy as np

from drivers.base.decks import Deck
from drivers.base.errors import RunError
from drivers.base.processes import cores, run_command
from drivers.base.progress import counted, following
from drivers.chain.case import Case
from drivers.chain.chain import arrays_of
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, VERLET, Engine, installed_codes, load_engine
from drivers.limits.criteria import rayleigh_time
from drivers.limits.refusal import FORCE
from drivers.limits.stable_step import predicted_limit
from drivers.run.run import default_limit_s, run_case, workers
from drivers.run.session import Session
from postproc.paper.simulate import case_of, exact
from postproc.read.observables import of_kind
from postproc.read.residual import residual
from validation.accuracy import schemes
from validation.accuracy.costs import cost_on
from validation.reference.adaptive import LEAST_TOLERANCE, integrate_adaptive
from validation.reference.symplectic import integrate_symplectic
from validation.reference.velocity_verlet import integrate_verlet
from validation.served_runs import Served, builds_of, left_out_if_failed, serve, serving
from validation.studies import ADAPTIVE, DONE, NOT_RUN, ORDER_4

SCENES = ("fig4", "fig5", "fig6b", "fig6d", "low-amplitude", "steel-chain", "long-chain")
SHORT_SCENES = SCENES[:-1]  # a thousand beads take half of the time
SHARES = tuple(10 ** (-k / 3) for k in range(13))  # of the predicted stability limit
TOLERANCES = (*(10.0**-k for k in range(2, 12)), LEAST_TOLERANCE)
FORCES_OF_ORDER_4 = 4  # a step
BUDGET_S, SHORT_BUDGET_S = 300.0, 30.0  # of engine time for the whole ladder
LONGEST = 0.04  # of the budget: no single run takes more
REPEATS, SHORT_S = 3, 0.03  # runs expected to be shorter are timed as the best of some
CONFIRMED = 3  # codes take every third step of the short ladder
PROCESS = {ADAPTIVE: REFERENCE, ORDER_4: VERLET, VERLET: VERLET}  # the engine that runs a method by itself
FIXED_STEP = {VERLET: integrate_verlet, ORDER_4: integrate_symplectic}
PAIR_STEPS_US = (1.0, 0.5, 0.2, 0.1, 0.05)
SOFTER = (10, 100, 1000)
FRACTIONS = (0.1, 0.2, 0.4)
MANY = 10  # cases of one process
ON_TWO_CORES = ("fig4", "long-chain")
TWO_CORES_FOR = "run.duration=0.5 ms"  # some hundred steps: the ratio is that of any of them


@dataclass(frozen=True)
class Rung:
    """One run of the ladder.

    Attributes:
        method: an engine, or an integrator of this repository.
        case: at its time step and samples.
        share: of the predicted stability limit; of ``ADAPTIVE`` the tolerance.
        expected_s: of its loop.
    """

    scene: str
    method: str
    case: Case
    share: float
    expected_s: float


@dataclass(frozen=True)
class Row:
    """One measurement; errors as in ``accuracy.schemes``, NaN where the scene does not show a quantity.

    Attributes:
        share_of_limit: the step over the predicted stability limit; of the adaptive integrator its tolerance.
        loop_s: CPU time of the time loop, on one core.
        wall_s: of a run by itself, start-up included.
        in_session_s: of the case in a process that serves many.
        status: ``done``, ``failed``, or ``not run`` with the reason.
    """

    scene: str
    method: str
    time_step_s: float
    share_of_limit: float
    steps: int
    bodies: int
    loop_s: float = nan
    wall_s: float = nan
    in_session_s: float = nan
    force: float = nan
    sensor_peak: float = nan
    wall_peak: float = nan
    arrival: float = nan
    speed: float = nan
    width: float = nan
    energy: float = nan
    momentum: float = nan
    status: str = DONE
    reason: str = ""


def rungs_of(scene: str, code_shares: Sequence[float] = SHARES) -> Iterator[Rung]:
    """In-repo methods at every step, codes at some, and the adaptive integrator at every tolerance."""
    base = case_of(scene)
    stable_s = predicted_limit(base.chain, float(base.sample_times_s[-1]))
    for share in SHARES:
        case = at_step(base, share, stable_s)
        for method in (*(installed_codes() if share in code_shares else ()), VERLET, ORDER_4):
            yield Rung(scene, method, case, share, expected_loop_s(method, case))
    for tolerance in TOLERANCES:
        yield Rung(scene, ADAPTIVE, base, tolerance, cost_on(REFERENCE).loop_s(base))


def expected_loop_s(method: str, case: Case) -> float:
    """Expected seconds of a fixed-step loop."""
    return FORCES_OF_ORDER_4 * cost_on(VERLET).loop_s(case) if method == ORDER_4 else cost_on(method).loop_s(case)


def at_step(case: Case, share: float, stable_s: float) -> Case:
    """The case at about a share of the stability limit; where that exceeds the sample interval, with fewer samples."""
    step, interval = share * stable_s, case.scene.run.sample_interval
    return case.at(ceil(interval / step * (1 - 1e-12))) if step <= interval else case.sampled_at_every(step)


def affordable(rungs: list[Rung], budget_s: float) -> tuple[list[Rung], list[Rung]]:
    """Rungs that fit the budget, cheapest first, and those that do not."""
    kept, left, spent = list[Rung](), list[Rung](), 0.0
    for rung in sorted(rungs, key=lambda rung: rung.expected_s):
        fits = rung.expected_s <= LONGEST * budget_s and spent + rung.expected_s <= budget_s
        (kept if fits else left).append(rung)
        spent += rung.expected_s if fits else 0.0
    return kept, left


def climb(budget_s: float, scenes: Sequence[str] = SCENES, *, short: bool = False) -> list[Row]:
    """All rows of the ladder, within a budget of engine time; codes may only confirm the scheme at some steps.

    Methods are worked at side by side: an engine runs while the errors of another's run are measured.
    """
    shares = SHARES[::CONFIRMED] if short else SHARES
    kept, left = affordable([rung for scene in scenes for rung in rungs_of(scene, shares)], budget_s)
    groups: dict[tuple[str, str], list[Rung]] = defaultdict(list)
    for rung in kept:
        groups[rung.scene, rung.method].append(rung)
    longest_first = sorted(groups.values(), key=lambda rungs: -sum(rung.expected_s for rung in rungs))
    engines = dict.fromkeys(PROCESS.get(rung.method, rung.method) for rung in kept)
    truth = _truths()
    with counted("runs at all steps", len(kept)) as count, workers(cores()) as pool:
        start_s = dict(zip(engines, pool.map(partial(start_up, case_of(scenes[0])), engines), strict=True))
        rows = [
            row for part in pool.map(lambda own: [*_climbed(own, start_s, truth, count)], longest_first) for row in part
        ]
    methods = [*installed_codes(), VERLET, ORDER_4, ADAPTIVE]
    rows.sort(key=lambda row: (scenes.index(row.scene), methods.index(row.method)))
    return rows + [_row(rung, status=NOT_RUN, reason=f"its loop would take {rung.expected_s:.0f} s") for rung in left]


def _truths() -> Callable[[Rung], schemes.Truth]:
    """Exact motions at the samples of rungs, each computed once."""
    known: dict[tuple[str, float, int], schemes.Truth] = {}
    computing = Lock()

    def truth(rung: Rung) -> schemes.Truth:
        key = (rung.scene, rung.case.scene.run.sample_interval, rung.case.scene.samples)
        with computing:
            if key not in known:
                known[key] = schemes.truth_of(rung.case)
            return known[key]

    return truth


def _climbed(
    rungs: Sequence[Rung], start_s: dict[str, float], truth: Callable[[Rung], schemes.Truth], count: Callable[[], None]
) -> Iterator[Row]:
    """Rows of one scene by one method, all by one process."""
    method = rungs[0].method
    with ExitStack() as stack:
        run = _in_repo if method in PROCESS else partial(_served, stack.enter_context(serving(method)))
        for rung in rungs:
            try:
                runs = [run(rung) for _ in range(REPEATS if rung.expected_s < SHORT_S else 1)]
                loop_s, case_s = min(each.loop_s for each in runs), min(each.case_s for each in runs)
                wall_s = start_s[PROCESS.get(method, method)] + case_s
                times = {"loop_s": loop_s, "wall_s": wall_s, "in_session_s": case_s}
                yield _row(rung, **times, **errors_by_group(rung.case, runs[-1].trace, truth(rung)))
            except RunError as error:
                yield _row(rung, status=error.status, reason=str(error))
            count()


def _served(session: Session, rung: Rung) -> Served:
    """A run in a session; RunError where it failed."""
    return serve(session, rung.case)


def _in_repo(rung: Rung) -> Served:
    """A run by an integrator of this repository; RunError where it blew up."""
    case, chain, scene = rung.case, arrays_of(rung.case.chain), rung.case.scene
    began = time.perf_counter()
    if rung.method == ADAPTIVE:
        motion = integrate_adaptive(chain, case.sample_times_s, rung.share)
    else:
        motion = FIXED_STEP[rung.method](chain, scene.time_step_s, scene.steps_per_sample, scene.samples)
    loop_s = time.perf_counter() - began
    if not np.isfinite(motion.force_N).all():
        raise RunError("not finite: the step is too large")
    return Served(schemes.trace_of(case, case.sample_times_s, motion), loop_s, loop_s)


def _row(rung: Rung, **measured: Any) -> Row:
    fixed = rung.method != ADAPTIVE
    step_s, steps = (rung.case.scene.time_step_s, rung.case.scene.steps) if fixed else (nan, 0)
    return Row(rung.scene, rung.method, step_s, rung.share, steps, rung.case.chain.bodies, **measured)


def errors_by_group(case: Case, trace: Trace, truth: schemes.Truth) -> dict[str, float]:
    """The errors of a row; of several gauges the largest."""
    groups = {
        "sensor_peak": [name for name in of_kind(truth.true, "peak") if name != "wall_peak"],
        "wall_peak": [name for name in truth.true if name == "wall_peak"],
        "arrival": of_kind(truth.true, "arrival"),
        "speed": of_kind(truth.true, "speed"),
        "width": [name for name in of_kind(truth.true, "width") if name.endswith("_4pct")],
    }
    found = schemes.errors_of(case, trace, truth, (FORCE, schemes.ENERGY, *chain.from_iterable(groups.values())))
    errors = {name: found[name] for name in (FORCE, schemes.ENERGY)}
    errors["momentum"] = schemes.momentum_error(case, trace, truth)
    return errors | {group: max((found[name] for name in names), default=nan) for group, names in groups.items()}


def start_up(case: Case, name: str) -> float:
    """Seconds of a process by itself that are not its loop; in-repo the better of two, as a first may compile."""
    times = 2 if load_engine(name).in_repository else 1
    with tempfile.TemporaryDirectory() as folder:
        records = [run_case(case, name, Path(folder), rerun=True).record for _ in range(times)]
    return min(record.wall_s - (record.loop_s or 0.0) for record in records)


@dataclass(frozen=True)
class Lever:
    """One measurement of a lever.

    Attributes:
        error: of the quantity, as in ``accuracy.error_measures``; NaN where the lever changes only the cost.
        gain: how many times cheaper (below 1: dearer) than without the lever; NaN where it is not about cost.
    """

    lever: str
    scene: str
    engine: str
    setting: str
    quantity: str
    error: float = nan
    gain: float = nan


def pull_all(*, short: bool = False) -> Iterator[Lever]:
    """Every lever; the short study leaves out higher precision, which takes twenty times as long, and a long chain."""
    in_repo, shared = (
        (sampling, extrapolation, rayleigh, softened),
        partial(two_cores, ON_TWO_CORES[: 1 if short else 2]),
    )
    levers: tuple[Callable[[], Iterator[Lever]], ...] = (*in_repo, shared, *[precision] * (not short), one_process)
    for lever in following(levers, "levers", len(levers), "lever"):
        yield from lever()


def sampling() -> Iterator[Lever]:
    """Peaks and arrivals read from samples so far apart, of the exact motion."""
    fine = schemes.truth_of(case_of("fig4"))
    for interval in ("0.5 us", "1 us", "2 us", "5 us", "10 us"):
        case = case_of("fig4", f"run.sample_interval={interval}", "run.time_step=0.1 us")
        seen = schemes.quantities(case, exact(case, 1e-12).trace)
        for name in ("bead_5_peak", "wall_peak", "wall_arrival", "speed_9_to_5"):
            error = abs(seen[name] / fine.true[name] - 1)
            yield Lever("sampling interval", "fig4", "any", interval, name, error)


def extrapolation() -> Iterator[Lever]:
    """Richardson's ``(4 F(dt/2) - F(dt)) / 3`` from two runs: the error, and the steps it saves."""
    for scene in ("fig4", "fig5", "steel-chain"):
        case = case_of(scene)
        truth = schemes.truth_of(case)
        for step_us in PAIR_STEPS_US:
            every = round(case.scene.run.sample_interval / step_us * 1e6)
            coarse, fine = schemes.verlet_of(case.at(every)), schemes.verlet_of(case.at(2 * every))
            both = replace(fine, force_N=(4 * fine.force_N - coarse.force_N) / 3)
            error = schemes.errors_of(case, both, truth, ("force",))["force"]
            alone = schemes.errors_of(case, fine, truth, ("force",))["force"]
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
            truth = schemes.truth_of(case)
            names = ["force", *(name for name in of_kind(truth.true, "peak", "speed") if not name.startswith("bead"))]
            for name, error in schemes.errors_of(case, schemes.verlet_of(case), truth, names).items():
                yield Lever("Rayleigh fraction", scene, "any", f"{fraction:g} of it", name, error)


def softened() -> Iterator[Lever]:
    """Softer contacts allow larger steps: what is left of V_s and F_m once scaled back by E^(2/5).

    Without gravity the chain is similar: times go with E^(-2/5) at a given striker speed, forces with E^(2/5).
    The gain is that of the step. Only a rigid wall and one material keep the scene similar otherwise.
    """
    for gravity in ("", "9.81 m/s^2"):
        base = ("wall.material=rigid", f"gravity={gravity}")
        hard = schemes.quantities(case := case_of("fig4", *base), exact(case, 1e-11).trace)
        for softer in SOFTER:
            longer = softer**0.4
            case = case_of(
                "fig4", *base, f"materials.ptfe.youngs_modulus={1.46e9 / softer} Pa",
                f"run.duration={0.8 * longer} ms", f"run.sample_interval={longer} us",
                f"run.time_step={longer / 10} us",
            )  # fmt: skip
            soft = schemes.quantities(case, exact(case, 1e-11).trace)
            where = "with gravity" if gravity else "without gravity"
            for name in ("speed_9_to_5", "bead_5_amplitude", "wall_amplitude"):
                error = abs(soft[name] * longer / hard[name] - 1)
                yield Lever("softened modulus", "fig4", "any", f"E/{softer}, {where}", name, error, longer)


def two_cores(scenes: Sequence[str] = ON_TWO_CORES) -> Iterator[Lever]:
    """The same run on two cores: how much faster its loop is."""
    pairs = [*product(scenes, installed_codes())]
    for scene, name in following(pairs, "two cores", len(pairs)):
        case, engine = case_of(scene, "run.time_step=1 us", TWO_CORES_FOR), load_engine(name)
        if engine.on_two_cores and len(engine.find() or ()) == 1:  # its command sets no number of its own
            with left_out_if_failed(f"{name}, two cores"):
                deck = engine.render(case)
                one, two = (_loop_s(case, engine, each) for each in (deck, engine.on_two_cores(deck)))
                yield Lever("two cores", scene, name, "2 cores", "loop", gain=one / two)


def _loop_s(case: Case, engine: Engine, deck: Deck) -> float:
    """Seconds in the loop of a process by itself; RunError where it failed."""
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
    """What builds of higher precision leave of the rounding of heights, also a kilometre up."""
    for name, (origin, wall) in product(installed_codes(), (("0 m", "wall at height 0"), ("1 km", "wall at 1 km"))):
        case = case_of("fig4", f"chain.origin={origin}", "run.time_step=0.1 us", "run.sample_interval=2 us")
        builds = builds_of(name)
        double_s = nan
        for build in builds if len(builds) > 1 else ():
            with left_out_if_failed(f"{build or name}, {wall}"), serving(name, build) as session:
                run = serve(session, case)
                double_s = double_s if build else run.loop_s
                error = float(residual(run.trace, schemes.verlet_of(case)).max())
                yield Lever("extended precision", "fig4", build or name, wall, "rounding", error, double_s / run.loop_s)


def one_process() -> Iterator[Lever]:
    """Many cases in one process against a process each."""
    case = case_of("fig4")
    for name in installed_codes():
        with left_out_if_failed(f"one process of {name} for many"), serving(name) as session:
            alone = start_up(case, name)
            runs = [serve(session, case) for _ in range(MANY)]
            loop_s, case_s = median(run.loop_s for run in runs), median(run.case_s for run in runs)
            yield Lever("one process for many", "fig4", name, f"{MANY} cases", "run", gain=(alone + loop_s) / case_s)
