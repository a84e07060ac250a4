"""Costs of runs by engine: those of ``inputs/costs.toml``, else measured here, once for each build."""

import json
import sys
import tomllib
from contextlib import closing, suppress
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from drivers.base import paths
from drivers.base.errors import RunError
from drivers.base.files import whole_file
from drivers.chain.case import Case, build_case
from drivers.engines import EXACT, Engine, load_engine
from drivers.run.build import Build, build_of
from drivers.run.session import Session
from drivers.scene.read_scene import read_scene

NOTE = ".cost.json"
MEASURED_ON = ("fig4", "run.duration=0.2 ms", "run.time_step=0.1 us")  # 2000 steps of 22 bodies
LOOP_S, MAX_FACTOR = 0.2, 50  # the longer run: more steps, until its loop takes about so long
REPEATS = 3


@dataclass(frozen=True)
class Cost:
    """Cost of a run on one engine: seconds of start-up, nanoseconds per body and time step, and body and sample."""

    start_s: float
    step_ns: float
    sample_ns: float

    def loop_s(self, case: Case) -> float:
        """Seconds in the time loop."""
        return case.chain.bodies * (self.step_ns * case.scene.steps + self.sample_ns * case.scene.samples) * 1e-9

    def run_s(self, case: Case) -> float:
        """Seconds of a whole process."""
        return self.start_s + self.loop_s(case)


def cost_on(name: str) -> Cost:
    """Cost of an engine: its entry, that of its adapter, or what its build is measured to cost.

    An engine that is neither known nor installed, or fails where it is measured, is taken for the dearest one known.
    """
    known, engine = _known(), load_engine(name)
    command = engine.find()
    of_code = command is None or len(command) == 1  # what a launcher adds is not known
    listed = known.get(name) or (known.get(engine.entry.adapter) if of_code else None)
    if listed is None and command is not None:
        listed = _measured(name, build_of(engine, paths.RUNS / name))
    return listed or max(known.values(), key=lambda cost: cost.step_ns)


@cache
def _known() -> dict[str, Cost]:
    return {name: Cost(**entry) for name, entry in tomllib.loads(paths.COSTS.read_text()).items()}


@cache
def _measured(name: str, build: Build) -> Cost | None:
    """Measured cost of a build, noted beside its runs; None where it fails."""
    note = paths.RUNS / name / NOTE
    try:
        noted = json.loads(note.read_text())
        if noted.pop("build") == build.identity:
            return Cost(**noted)
    except (OSError, ValueError, LookupError, TypeError, AttributeError):
        pass
    try:
        cost = measure(load_engine(name), build)
    except RunError as error:
        print(f"{name}: its cost could not be measured: {error}", file=sys.stderr)
        return None
    with suppress(OSError):  # a place where nobody may write: it is measured again
        note.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(note) as draft:
            draft.write_text(json.dumps({"build": build.identity, **asdict(cost)}))
    where = f"no entry in {paths.shown(paths.COSTS)}, measured and kept in {paths.shown(note)}"
    print(f"{name}: {where}: {', '.join(entry_of(name, cost)[1:])}", file=sys.stderr)
    return cost


def measure(engine: Engine, build: Build) -> Cost:
    """Cost of a build, by a few short runs in one process, each the best of some; about two seconds.

    Raises:
        RunError: a run failed, or its output does not tell the time in the loop.
    """
    from validation.served_runs import serve  # pandas and more: only where it is needed

    scene, *settings = MEASURED_ON
    few = build_case(read_scene(scene, (*settings, "run.sample_interval=10 us")))
    many = build_case(read_scene(scene, (*settings, "run.sample_interval=0.1 us")))
    with TemporaryDirectory() as folder, closing(Session(engine, build.command, Path(folder))) as session:

        def best(case: Case) -> tuple[float, float]:
            """Seconds in the loop, and beside it."""
            runs = [serve(session, case) for _ in range(REPEATS)]
            if not all(run.loop_s for run in runs):
                raise RunError("the output does not have the line of loop_pattern")
            return min(run.loop_s for run in runs), min(run.case_s - run.loop_s for run in runs)

        loop_s, beside_s = best(few)
        factor = int(min(max(LOOP_S / loop_s, 2), MAX_FACTOR))
        longer_s, _ = best(few.at(factor * few.scene.steps_per_sample))
        sampled_s, _ = best(many)
        start_s = session.start_s + beside_s
    per_step_s = (longer_s - loop_s) / (few.scene.steps * (factor - 1))
    per_sample_s = (sampled_s - loop_s) / (many.scene.samples - few.scene.samples)
    step_ns, sample_ns = (max(1e9 * each / few.chain.bodies, 0.0) for each in (per_step_s, per_sample_s))
    return Cost(start_s, 0.0 if engine.scheme == EXACT else step_ns, sample_ns)


def entry_of(name: str, cost: Cost) -> list[str]:
    """Lines of an entry for ``inputs/costs.toml``."""
    return [f"[{name}]", *(f"{key} = {value:.2g}" for key, value in asdict(cost).items())]
