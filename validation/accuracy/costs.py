"""Cost of a run by engine, from ``inputs/costs.toml`` or measured once for each build; engines by cost."""

import tomllib
from collections.abc import Collection, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

from drivers.base import paths
from drivers.base.cache import load, store
from drivers.base.errors import RunError
from drivers.base.terminal import say
from drivers.chain.case import Case, build_case
from drivers.engines import EXACT, Engine, expected_engines, installed, load_engine
from drivers.limits import inability
from drivers.run.build import Build, build_of
from drivers.run.compute import compute
from drivers.run.run import run_identity
from drivers.run.run_folder import DAMAGED, find_run
from drivers.scene.read_scene import read_scene

MEASURED_ON = ("fig4", "run.duration=0.2 ms", "run.time_step=0.1 us")  # 2000 steps of 22 bodies
LOOP_S, MAX_FACTOR = 0.2, 50  # the longer run has up to MAX_FACTOR times the steps, so that its loop takes LOOP_S
REPEATS = 3


@dataclass(frozen=True)
class Cost:
    """Cost of a run on one engine.

    Attributes:
        start_s: start-up, in s.
        step_ns: per body and time step, in ns.
        sample_ns: per body and sample, in ns.
        sideways_ns: per body and time step in three dimensions, in ns; 0 if it was not measured.
    """

    start_s: float
    step_ns: float
    sample_ns: float
    sideways_ns: float = 0.0

    def loop_s(self, case: Case) -> float:
        """Time of a run in the time loop, in s."""
        step_ns = self.step_ns if case.chain.straight else self.sideways_ns or self.step_ns
        return case.chain.bodies * (step_ns * case.scene.steps + self.sample_ns * case.scene.samples) * 1e-9

    def run_s(self, case: Case) -> float:
        """Time of a run in a process of its own, in s."""
        return self.start_s + self.loop_s(case)


def cost_on(name: str) -> Cost:
    """Cost of an engine: the entry of the engine or of its adapter in the file, else the measured cost of its build.

    An engine without an entry that is not installed, or fails when measured, gets the highest listed cost.
    """
    known, engine = _known(), load_engine(name)
    command = engine.find()
    of_code = command is None or len(command) == 1  # the start-up time of a launcher is not known
    listed = known.get(name) or (known.get(engine.entry.adapter) if of_code else None)
    if listed is None and command is not None:
        listed = _measured(name, build_of(engine))
    return listed or max(known.values(), key=lambda cost: cost.step_ns)


@cache
def _known() -> dict[str, Cost]:
    return {name: Cost(**entry) for name, entry in tomllib.loads(paths.COSTS.read_text()).items()}


@cache
def _measured(name: str, build: Build) -> Cost | None:
    """Measured cost of a build, from the cache if it is known; None if a run fails."""
    if stored := load(_key(name, build)):
        return Cost(**stored)
    try:
        cost = measured_cost(load_engine(name), build)
    except RunError as error:
        say(f"{name}: the cost could not be measured: {error}")
        return None
    where = f"no entry in {paths.shown(paths.COSTS)}; cost measured and cached"
    say(f"{name}: {where}: {', '.join(entry_of(name, cost)[1:])}")
    return cost


def _key(name: str, build: Build) -> list[str]:
    return ["cost", name, build.identity]


def measured_cost(engine: Engine, build: Build) -> Cost:
    """Measure the cost of a build by a few short runs, each the best of three; about two seconds.

    The cost is kept for ``cost_on``.

    Raises:
        RunError: a run failed, or the output lacks the time in the loop.
    """
    scene, *settings = MEASURED_ON
    few = build_case(read_scene(scene, (*settings, "run.sample_interval=10 us")))
    many = build_case(read_scene(scene, (*settings, "run.sample_interval=0.1 us")))

    def best(case: Case) -> float:
        """Shortest time in the loop, in s."""
        runs = [compute(case, engine.name, build=build) for _ in range(REPEATS)]
        loops_s = [run.loop_s for run in runs if run.done and run.loop_s]
        if len(loops_s) < REPEATS:
            raise RunError("no line of the output matches loop_pattern")
        return min(loops_s)

    start_s = 0.0  # an in-repo engine integrates in the process of the command
    if not engine.in_repository:
        alone = compute(few, engine.name, build=build, own_process=True)
        start_s = alone.wall_s - (alone.loop_s or 0.0) if alone.done else 0.0
    few_s = best(few)
    longer = few.at(int(min(max(LOOP_S / few_s, 2), MAX_FACTOR)) * few.scene.steps_per_sample)
    step_ns = 1e9 * (best(longer) - few_s) / (longer.work - few.work)
    sample_ns = 1e9 * (best(many) - few_s) / (many.scene.samples - few.scene.samples) / few.chain.bodies
    cost = Cost(start_s, 0.0 if engine.scheme == EXACT else max(step_ns, 0.0), max(sample_ns, 0.0))
    store(_key(engine.name, build), asdict(cost))
    return cost


def entry_of(name: str, cost: Cost) -> list[str]:
    """Lines of an entry of ``inputs/costs.toml``."""
    return [f"[{name}]", *(f"{key} = {value:.2g}" for key, value in asdict(cost).items() if key != "sideways_ns")]


def capable_engines(case: Case, among: Collection[str] = ()) -> list[str]:
    """Engines, installed or expected, that can run a case with its accuracy; ``among`` others, if given."""
    names = among or expected_engines()
    return [name for name in names if inability(case, name) is None]


def ranking_of(
    case: Case, among: Collection[str] = (), runs: Path | None = None
) -> tuple[dict[str, Cost], dict[str, str]]:
    """Costs of the engines that can run a case, the cheapest first, and of those left out the ``fault``, by name."""
    faults = {name: fault(case, name, runs) for name in capable_engines(case, among)}
    costs = {name: cost_on(name) for name, why in faults.items() if not why}
    by_cost = dict(sorted(costs.items(), key=lambda item: item[1].run_s(case)))
    return by_cost, {name: why for name, why in faults.items() if why}


def auto_engines(case: Case, runs: Path | None = None) -> Iterator[str]:
    """Installed engines that can run a case, the cheapest first; those with a ``fault`` become lines on stderr.

    Raises:
        RunError: no engine is left.
    """
    costs, faults = ranking_of(case, runs=runs)
    here = installed([*costs, *faults])
    for name in filter(faults.get, here):
        say(f"{case.scene.name}: {name}: {faults[name]}; --engine auto leaves it out")
    yield from costs
    if here:
        raise RunError(f"{case.scene.name}: no engine is left for --engine auto, after {', '.join(sorted(here))}")
    others = f"; {', '.join(faults)} would" if faults else ""
    raise RunError(f"no installed engine models all of this scene{others}")


def fault(case: Case, name: str, runs: Path | None = None) -> str:
    """Reason to leave out an engine; empty if there is none.

    It is not installed, its build failed ``beads engine`` or, if it is the user's own, was never tested, or its run of
    the case in ``runs`` failed.
    """
    engine = load_engine(name)
    if not installed([name]):
        return "it is not installed"
    passed = load(kit_key(name))
    if passed is None and engine.where not in ("", paths.shown(paths.ENGINES)):  # an entry of the user
        return f"its build was never tested by beads engine {name}"
    if passed is False:
        return f"its build failed beads engine {name}"
    with suppress(RunError):  # a faulty adapter renders no deck
        identity = run_identity(name, build_of(engine), engine.render(case).sha256) if runs else ""
        if runs and (run := find_run(runs / name, identity, {})) and run.record.status not in ("done", DAMAGED):
            return f"{run.trouble} (see {paths.shown(run.folder)}; --rerun tries again)"
    return ""


def kit_key(name: str) -> list[str]:
    """Key in the cache of the outcome of ``beads engine``: True if the installed build passed."""
    return ["kit", name, build_of(load_engine(name)).identity]
