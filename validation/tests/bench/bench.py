"""Costs of integrators, codes, batches, fits, commands and the report, as rows of ``results/bench.csv``."""

import resource
import shutil
import subprocess
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
import psutil

from drivers.base import paths
from drivers.base.files import whole_file
from drivers.chain.chain import arrays_of
from drivers.engines import installed, installed_codes
from drivers.run.run import run_case
from drivers.run.run_folder import record_of
from validation.calibration.fit import solve
from validation.calibration.problem import paper_data, pose
from validation.reference.adaptive import MIN_TOLERANCE, integrate_adaptive
from validation.reference.velocity_verlet import integrate_verlet
from validation.tests.helpers.browser import browser
from validation.tests.helpers.commands import BEADS
from validation.tests.helpers.live import Live, served
from validation.tests.helpers.scenes import case_of

TURNS = {10: 200, 50: 200, 200: 200, 1000: 200, 20: 2000}  # of a knob of the live page, by beads
AT_ONCE = 100  # turns, in one question to the browser
TURN = """
const [turns, done] = arguments, named = (name) => Bokeh.documents[0].get_model_by_name(name);
const slider = named("striker.speed slider"), source = named("forces").renderers.at(-1).data_source, taken = [];
const turn = () => {
  if (taken.length === turns) return done(taken);
  began = performance.now(), slider.value = 0.3 + 0.4 * ((taken.length * 37) % 101) / 101;
};
let began;
const changed = () => { taken.push(performance.now() - began); setTimeout(turn, 50); };
source.connect(source.properties.data.change, () => taken.length < turns && changed());
turn();
"""
HEAP = "return performance.memory.usedJSHeapSize"
Row = tuple[str, float, str]  # quantity, value, unit
COLUMNS = ("quantity", "value", "unit")
STEP = "run.time_step=0.1 us"
ERRORS = {
    ("fig4", "run.duration=0.6 ms"): (1e-4, 1e-6, 1e-8, 1e-11),
    ("long-chain",): (1e-6,),
}  # asked of the reference, by scene with settings
STEPS = {22: 20_000, 1000: 2000, 10_000: 400, 100_000: 60}  # by bodies
CASES: Mapping[tuple[str, ...], int] = {
    ("verlet",): 1000,
    ("reference",): 1000,
    ("liggghts",): 200,
    ("lammps",): 200,
    ("yade",): 200,
    ("kratos",): 200,
}  # by engines
STUDY = """
scene = "fig4"
engines = {engines}
set = {{ "run.time_step" = "0.1 us" }}
[[axis]]
key = "striker.speed"
from = "1.9 m/s"
to = "2.1 m/s"
count = {cases}
"""
QUOTED = ("fig4", "table1", "fig5")
TWO = ("materials.ptfe.youngs_modulus", "contact.restitution")
FREE = {
    "two parameters, Fig. 4": (QUOTED[:1], TWO),
    "two parameters, all quoted data": (QUOTED, TWO),
    "four parameters, all quoted data": (QUOTED, (*TWO, "sensor.time_constant", "chain.mass=0.1 g..0.15 g")),
}
FITTED = ("viscoelastic", "kuwabara-kono", "hunt-crossley")
FINISHED = (("--help",), ("plan", "fig4"), ("compare", "fig4"))
LARGE = {("lammps", 100_000): 500, ("liggghts", 100_000): 500, ("verlet", 100_000): 500, ("verlet", 1_000_000): 50}


def best(repeats: int, *actions: Callable[[], object]) -> list[float]:
    """Shortest time of each action in s, all in turn, after a round that may compile."""
    times = np.empty((1 + repeats, len(actions)))
    for place in np.ndindex(times.shape):
        began = time.perf_counter()
        actions[place[1]]()
        times[place] = time.perf_counter() - began
    return [float(seconds) for seconds in times[1:].min(axis=0)]


def reference(
    asked: Mapping[tuple[str, ...], Sequence[float]] = ERRORS, repeats: int = 100, long_repeats: int = 5
) -> Iterator[Row]:
    """Cost of the exact motion as a multiple of that of ``verlet`` on the same scene and samples, and its error."""
    for (scene, *settings), tolerances in asked.items():
        case = case_of(scene, *settings, STEP)
        chain, times = arrays_of(case.chain), case.sample_times_s
        grid = case.scene.time_step_s, case.scene.steps_per_sample, case.scene.samples
        exact = integrate_adaptive(chain, times, MIN_TOLERANCE).force_N
        for tolerance in tolerances:
            verlet_s, exact_s = best(
                repeats if case.chain.bodies < 100 else long_repeats,
                partial(integrate_verlet, chain, *grid),
                partial(integrate_adaptive, chain, times, tolerance),
            )
            off = np.abs(integrate_adaptive(chain, times, tolerance).force_N - exact).max()
            name = f"reference, {scene}, error {tolerance:.0e}"
            yield name, exact_s / verlet_s, f"times verlet of {verlet_s * 1e3:.3g} ms"
            yield f"{name}, reached", float(off / np.abs(exact - exact[0]).max()), "of the largest change"


def steps(counts: Mapping[int, int] = STEPS, repeats: int = 5) -> Iterator[Row]:
    """Cost of a step of a chain under 1 N, in which every contact is closed, in ``verlet`` and in the codes' loops.

    The start of a code is the time of its process outside the loop.
    """
    for bodies, count in counts.items():
        chain = (f"chain.count={bodies - 1}", "chain.sensors=[]", "chain.precompression=1 N", "gravity=", "tube=")
        case = case_of("fig4", *chain, STEP, f"run.duration={count / 10} us", f"run.sample_interval={count / 10} us")
        (own_s,) = best(repeats, partial(integrate_verlet, arrays_of(case.chain), 1e-7, count, 2))
        with TemporaryDirectory() as runs:
            records = {code: run_case(case, code, Path(runs)).record for code in installed_codes()}
        loops_s = {"verlet": own_s} | {code: record.loop_s or np.nan for code, record in records.items()}
        for name, loop_s in loops_s.items():
            yield f"step, {name}, {bodies} bodies", loop_s / bodies / count * 1e9, "ns per body"
        for name, record in records.items():
            yield f"start, {name}, {bodies} bodies", (record.wall_s or np.nan) - loops_s[name], "s"


def batch(cases: Mapping[tuple[str, ...], int] = CASES) -> Iterator[Row]:
    """Rows per second of batches of Fig. 4 at 0.1 us on two workers, with their start; time to list finished rows."""
    for engines, count in cases.items():
        if installed(engines) != engines:
            continue
        with TemporaryDirectory() as home:
            study, places = Path(home, "bench.toml"), ("--runs", home, "--results", home)
            study.write_text(STUDY.format(engines=[*engines], cases=count))
            _, batch_s = spent(*BEADS, "batch", study, "--workers", "2", *places)
            _, status_s = spent(*BEADS, "status", study, "--runs", home)
        yield f"batch, {' '.join(engines)}", count * len(engines) / batch_s, "rows per s"
        yield f"status of {count} rows, {' '.join(engines)}", status_s, "s"


def fits(asked: Mapping[str, tuple[Sequence[str], Sequence[str]]] = FREE) -> Iterator[Row]:
    """Time of fits alone, on one core."""
    for name, (sets, free) in asked.items():
        problem, began = pose(paper_data(sets, ()), free), time.perf_counter()
        solve(problem, quick=True)
        yield f"fit, {name}", time.perf_counter() - began, "s"


def experiments(
    laws: Sequence[str] = ("viscoelastic", "kuwabara-kono", "hunt-crossley"), count: int = 100
) -> Iterator[Row]:
    """Time of a fit of the example by several laws, of a prediction by it, and of a design of experiments."""
    with TemporaryDirectory() as home:
        place = ("--results", home)
        compared = [word for law in laws for word in ("--law", law)]
        asked = {
            f"fit of {len(laws)} laws": ("fit", "example-measured", "--free", TWO[0], "--quick", *compared),
            "prediction": ("predict", "fit-example-measured", "fig4"),
            f"design of {count} experiments": (
                *("design", "fit-example-measured", "--vary", "striker.speed=0.5..4", "--vary", "chain.count=12..40"),
                *("--gauges", "2..12", "--candidates", str(count)),
            ),
        }
        for name, words in asked.items():
            yield name, spent(*BEADS, *words, *place)[1], "s"


def commands(asked: Sequence[tuple[str, ...]] = FINISHED, repeats: int = 5) -> Iterator[Row]:
    """CPU time of commands whose runs are finished and whose results are cached."""
    with TemporaryDirectory() as runs:
        for words in asked:
            place = ("--runs", runs) if "compare" in words else ()
            _, *cpu_s = (spent(*BEADS, *words, *place)[0] for _ in range(1 + repeats))
            yield f"beads {' '.join(words)}", min(cpu_s), "s of CPU"


def large(asked: Mapping[tuple[str, int], int] = LARGE) -> Iterator[Row]:
    """Time of runs of very long chains, of the engine and of all around it, and memory of all processes so far."""
    for (engine, bodies), count in asked.items():
        if not installed([engine]):
            continue
        keys = (f"chain.count={bodies - 1}", f"chain.sensors=[{{ from_wall = {bodies - 9} }}]", STEP)
        times = (f"run.sample_interval={count / 50} us", f"run.duration={count / 10} us")
        words = [word for key in (*keys, *times) for word in ("--set", key)]
        with TemporaryDirectory() as runs:
            spent(*BEADS, "run", "fig4", "--engine", engine, "--runs", runs)  # checks the build, once
            _, wall_s = spent(*BEADS, "run", "long-chain", "--engine", engine, "--runs", runs, *words)
            (folder,) = Path(runs, engine).glob("long-chain-*")
            engine_s = record_of(folder).wall_s or np.nan
        most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6
        yield f"run, {engine}, {bodies} bodies", engine_s, "s"
        yield f"run, {engine}, {bodies} bodies, around the engine", wall_s - engine_s, "s"
        yield f"run, {engine}, {bodies} bodies, memory so far", most, "GB"


def live(turns: Mapping[int, int] = TURNS) -> Iterator[Row]:
    """Time from a turn of a knob of the live page to the data of the curve, and memory after all turns, in Chromium."""
    for count, times in turns.items() if shutil.which("chromium") else ():
        words = ("fig4", "--set", f"chain.count={count}")
        with served(*words) as (address, process), browser() as driver:
            page, server = Live(driver, address), psutil.Process(process.pid)
            driver.set_script_timeout(60)
            driver.execute_async_script(TURN, 10)
            before_B, began_MB = driver.execute_script(HEAP), server.memory_info().rss / 1e6
            parts = [min(AT_ONCE, times - done) for done in range(0, times, AT_ONCE)]
            taken_ms = [ms for part in parts for ms in driver.execute_async_script(TURN, part)]
            assert "striker.speed" in page.text("command")
            yield f"live page, {count} beads: knob to curve, median", float(np.median(taken_ms)), "ms"
            yield f"live page, {count} beads: knob to curve, worst of {times}", max(taken_ms), "ms"
            yield (
                f"live page, {count} beads: memory of the server after {times} turns",
                server.memory_info().rss / 1e6,
                "MB",
            )
            yield f"live page, {count} beads: the same before", began_MB, "MB"
            grown = driver.execute_script(HEAP) / before_B
            yield f"live page, {count} beads: memory of the browser's page, after divided by before", grown, ""


def clone(target: str = "report", before: Sequence[str] = (".venv/.ready", ".venv/.engines")) -> Iterator[Row]:
    """Time of a target of make in a fresh clone of the last commit, after others."""
    with TemporaryDirectory() as home:
        spent("git", "clone", "-q", paths.ROOT, home)
        if before:
            spent("make", "-C", home, *before)
        cpu_s, wall_s = spent("make", "-C", home, target)
        yield f"make {target}", wall_s, "s"
        yield f"make {target}, all cores", cpu_s, "s of CPU"


def spent(*words: str | Path) -> tuple[float, float]:
    """CPU and wall time of a command, in s.

    Raises:
        CalledProcessError: the command failed.
    """
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    after, wall_s = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - began
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall_s


ALL: tuple[Callable[..., Iterator[Row]], ...] = (
    reference,
    steps,
    batch,
    fits,
    experiments,
    commands,
    large,
    live,
    clone,
)


def write(rows: Iterable[Row], path: Path) -> None:
    """Print rows as they come, and write them as CSV."""
    written = []
    for quantity, value, unit in rows:
        print(f"{quantity:<52} {value:10.3g} {unit}", flush=True)
        written.append((quantity, value, unit))
    path.parent.mkdir(exist_ok=True)
    with whole_file(path) as draft:
        pd.DataFrame(written, columns=COLUMNS).to_csv(draft, index=False)
