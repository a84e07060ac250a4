"""What users do besides choosing a step: each lever's error and its cost, measured."""

import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from math import sqrt
from pathlib import Path

import numpy as np
import pandas as pd

from drivers.base.decks import Deck
from drivers.base.errors import RunError
from drivers.base.files import whole_file
from drivers.base.processes import run_command
from drivers.chain.case import Case
from drivers.engines import load_engine
from drivers.limits.criteria import rayleigh_time
from drivers.run.run import default_limit_s
from drivers.run.session import served_by
from postproc.paper.simulate import case_of, exact
from postproc.read.observables import of_kind
from postproc.read.residual import residual
from validation.accuracy.error_measures import errors_of, quantities, truth_of, verlet_of
from validation.trade.climb import start_up, timed_in_session

PAIR_STEPS_US = (1.0, 0.5, 0.2, 0.1, 0.05)
SOFTER = (10, 100, 1000)
FRACTIONS = (0.1, 0.2, 0.4)
MANY = 20
ALONG = "processors      1 1 2\nboundary "  # two halves of the chain, one above the other


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
    error: float
    gain: float


def pull_all() -> list[Lever]:
    """Every lever."""
    return [
        *sampling(), *extrapolation(), *rayleigh(), *softened(), *two_cores(), *precision(), *one_process(),
    ]  # fmt: skip


def sampling() -> Iterator[Lever]:
    """Peaks and arrivals read from samples so far apart, of the exact motion."""
    fine = truth_of(case_of("fig4"))
    for interval in ("0.5 us", "1 us", "2 us", "5 us", "10 us"):
        case = case_of("fig4", f"run.sample_interval={interval}", "run.time_step=0.1 us")
        seen = quantities(case, exact(case, 1e-12).trace)
        for name in ("bead_5_peak", "wall_peak", "wall_arrival", "speed_9_to_5"):
            error = abs(seen[name] / fine.true[name] - 1)
            yield Lever("sampling interval", "fig4", "any", interval, name, error, float("nan"))


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
                yield Lever("Rayleigh fraction", scene, "any", f"{fraction:g} of it", name, error, float("nan"))


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
            for name, power in (("speed_9_to_5", 1), ("bead_5_amplitude", 1), ("wall_amplitude", 1)):
                error = abs(soft[name] * longer**power / hard[name] - 1)
                yield Lever("softened modulus", "fig4", "any", f"E/{softer}, {where}", name, error, longer)


def two_cores() -> Iterator[Lever]:
    """The same run on two cores: how much faster its loop is."""
    for scene in ("fig4", "long-chain"):
        case = case_of(scene, "run.time_step=1 us")
        for name in ("liggghts", "yade"):
            one, two = (_loop(case, name, two=two) for two in (False, True))
            if one and two:
                yield Lever("two cores", scene, name, "2 cores", "loop", float("nan"), one / two)


def _loop(case: Case, name: str, *, two: bool) -> float | None:
    """Seconds of the loop on one or two cores; None where the engine is missing or fails."""
    engine = load_engine(name)
    executable = engine.find()
    if executable is None:
        return None
    deck = engine.render(case)
    command = deck.command_with(executable)
    if two and name == "liggghts":
        command = ("mpirun", "--allow-run-as-root", "--oversubscribe", "-np", "2", *command)
        files = {file: text.replace("boundary ", ALONG) for file, text in deck.files.items()}
        deck = Deck(files, deck.command, deck.raw)
    elif two:
        command = (command[0], "-j2", *command[1:])
    return _run(case, name, deck, command)[0]


def _run(case: Case, name: str, deck: Deck, command: tuple[str, ...]) -> tuple[float | None, float | None]:
    """Seconds of the loop, and the force error against the same scheme in overlaps where the output can be read."""
    engine = load_engine(name)
    with tempfile.TemporaryDirectory() as folder:
        for file, text in deck.files.items():
            Path(folder, file).write_text(text)
        run_command(command, Path(folder), default_limit_s(case), **engine.variables)
        loop = engine.loop_seconds(Path(folder, "stdout.txt").read_text(errors="replace"))
        try:
            error = float(residual(engine.read(case, Path(folder)), verlet_of(case)).max())
        except RunError:
            error = None
    return loop, error


def precision() -> Iterator[Lever]:
    """What YADE's builds of higher precision leave of the rounding of heights, also a kilometre up."""
    double = load_engine("yade").find()
    if double is None:
        return
    for origin in ("0 m", "1 km"):
        case = case_of("fig4", f"chain.origin={origin}", "run.time_step=0.1 us", "run.sample_interval=2 us")
        deck = load_engine("yade").render(case)
        first: float | None = None
        for build in ("yade", "yade-longdouble", "yade-float128"):
            executable = double.with_name(build)
            if not executable.exists():
                continue
            loop, error = _run(case, "yade", deck, (str(executable), *deck.command[1:]))
            if loop is None or error is None:
                continue
            first = first or loop
            at = "wall at height 0" if origin == "0 m" else f"wall at {origin}"
            yield Lever("extended precision", "fig4", build, at, "rounding", error, first / loop)


def one_process() -> Iterator[Lever]:
    """Many cases in one process against a process each."""
    case = case_of("fig4")
    for name in ("liggghts", "yade"):
        if load_engine(name).find() is None:
            continue
        with tempfile.TemporaryDirectory() as folder, served_by(name, Path(folder)) as session:
            alone = start_up(name, case, Path(folder))
            cases = [timed_in_session(name, case, session, 1.0) for _ in range(MANY)]
        loop = float(np.median([loop_s for _, loop_s, _ in cases]))
        each = float(np.median([seconds for _, _, seconds in cases]))
        yield Lever("one process for many", "fig4", name, f"{MANY} cases", "run", float("nan"), (alone + loop) / each)


def write_levers(levers: list[Lever], path: Path) -> None:
    """Writes ``trade-levers.csv``."""
    with whole_file(path) as draft:
        pd.DataFrame([asdict(lever) for lever in levers]).to_csv(draft, index=False)
