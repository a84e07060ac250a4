"""Cost of the in-repo integrators, of scipy's DOP853 and of the codes, measured in one run."""

import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from drivers.chain.case import Case, build_case
from drivers.chain.chain import arrays_of
from drivers.engines import installed_codes, missing_codes
from drivers.run.run import run_case
from drivers.scene.read_scene import read_scene
from validation.reference.adaptive import integrate_adaptive
from validation.reference.dop853 import slope
from validation.reference.hertz_chain import Array, HertzChain, hertz_force
from validation.reference.symplectic import integrate_symplectic
from validation.reference.velocity_verlet import integrate_verlet

REPEATS = 5
ENGINE_STEPS = {22: 20_000, 1000: 2000, 10_000: 400, 100_000: 60}
IN_REPO_STEPS = {22: 400_000, 1000: 20_000, 10_000: 4000, 100_000: 1000, 1_000_000: 400}


def best_time(action: Callable[[], object]) -> float:
    """Shortest time of several runs, in s, after one that may compile."""
    action()
    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        action()
        times.append(time.perf_counter() - began)
    return min(times)


def bench() -> None:
    """Print all tables."""
    bench_adaptive()
    bench_order()
    bench_fixed_step(bench_engines())


def bench_adaptive() -> None:
    """Print time and error of the reference and of scipy's DOP853 with the same slope: Fig. 4, 0.6 ms, 600 samples."""
    chain = arrays_of(build_case(read_scene("fig4")).chain)
    times = np.linspace(0, 6e-4, 601)
    exact = integrate_adaptive(chain, times).force_N

    def error(force: Array) -> float:
        return float(np.abs(force - exact).max() / exact.max())

    print("Fig. 4, 0.6 ms, 600 samples: force error and time, and scipy's at the same tolerance or better")
    print(f"{'asked':>8} {'error':>9} {'time ms':>8}   {'scipy rtol':>10} {'error':>9} {'time ms':>8} {'ratio':>6}")
    for tolerance in (1e-4, 1e-6, 1e-8, 1e-10, 1e-11):
        own = best_time(partial(integrate_adaptive, chain, times, tolerance))
        own_error = error(integrate_adaptive(chain, times, tolerance).force_N)
        rtol = next(r for r in 10.0 ** -np.arange(3, 14.5, 0.5) if error(_scipy(chain, times, r)) <= tolerance)
        theirs = best_time(partial(_scipy, chain, times, rtol))
        their_error = error(_scipy(chain, times, rtol))
        print(
            f"{tolerance:8.0e} {own_error:9.1e} {own * 1e3:8.2f}   {rtol:10.1e} {their_error:9.1e} {theirs * 1e3:8.1f}"
            f" {theirs / own:6.1f}"
        )


def _scipy(chain: HertzChain, times: Array, rtol: float) -> Array:
    """Forces by scipy's DOP853 with the compiled slope of the reference."""
    n = chain.mass_kg.size
    bodies = (1 / chain.mass_kg, chain.stiffness, np.zeros(0), chain.load_N / chain.mass_kg)

    def derivative(_: float, state: Array) -> Array:
        result = np.empty_like(state)
        slope(state, 1.0, result, bodies)
        return result

    start = np.concatenate([chain.overlap_m, chain.velocity_m_s])
    scale = np.repeat([1e-5, 1.0], n)
    solution = solve_ivp(
        derivative, (0.0, times[-1]), start, method="DOP853", t_eval=times, rtol=rtol, atol=0.1 * rtol * scale
    )
    return hertz_force(chain.stiffness, solution.y[:n].T)


def bench_order() -> None:
    """Print the error of Verlet and of the symplectic method of order 4 against the number of forces, for Fig. 4."""
    chain = arrays_of(build_case(read_scene("fig4")).chain)
    exact = integrate_adaptive(chain, np.linspace(0, 6e-4, 601)).force_N
    print("\nFig. 4 at a fixed step: force error by number of force evaluations per microsecond")
    print(f"{'forces':>8} {'Verlet':>9} {'order 4':>9}")
    for steps in (1, 2, 4, 8, 16, 32, 64):
        verlet = integrate_verlet(chain, 1e-6 / (4 * steps), 4 * steps, 601).force_N
        fourth = integrate_symplectic(chain, 1e-6 / steps, steps, 601).force_N
        errors = (float(np.abs(force - exact).max() / exact.max()) for force in (verlet, fourth))
        print(f"{4 * steps:>8}", *(f"{error:9.1e}" for error in errors))


def bench_engines() -> dict[tuple[str, int], float]:
    """Print the start-up times of the codes, and return ns per bead and step in their own loops."""
    costs: dict[tuple[str, int], float] = {}
    print("\nthe codes, one process: seconds outside the time loop (start-up, building the chain, writing)")
    with tempfile.TemporaryDirectory() as folder:
        for engine in missing_codes():
            print(f"{engine}: not installed, not run")
        for engine in installed_codes():
            for bodies, steps in ENGINE_STEPS.items():
                case = _compressed_chain(bodies, steps)
                record = run_case(case, engine, Path(folder)).record
                if record.loop_s is None:
                    print(f"{engine} {bodies}: {record.reason}", file=sys.stderr)
                    continue
                costs[engine, bodies] = record.loop_s / bodies / steps * 1e9
                print(f"{engine:>9} {bodies:>8} bodies {(record.wall_s or 0.0) - record.loop_s:7.2f} s")
    return costs


def bench_fixed_step(engine_costs: dict[tuple[str, int], float]) -> None:
    """Print ns per bead and step of velocity Verlet, in the repository and in the engines."""
    print("\nvelocity Verlet: ns per bead and step (in brackets: ratio to the in-repo cost)")
    engines = list(dict.fromkeys(engine for engine, _ in engine_costs))
    print(f"{'bodies':>8} {'in-repo':>9}", *(f"{engine:>16}" for engine in engines))
    for bodies, steps in IN_REPO_STEPS.items():
        own = _own_cost(bodies, steps)
        cells = [
            f"{cost:8.1f} ({cost / own:.0f})" if (cost := engine_costs.get((engine, bodies))) else "-"
            for engine in engines
        ]
        print(f"{bodies:>8} {own:9.2f}", *(f"{cell:>16}" for cell in cells), flush=True)


def _compressed_chain(bodies: int, steps: int) -> Case:
    """Struck chain under 1 N, so that every contact is closed; sampled at start and end."""
    settings = (
        f"chain.count={bodies - 1}", "chain.sensors=[]", "chain.precompression=1 N", "gravity=", "tube=",
        f"run.duration={steps / 10} us", f"run.sample_interval={steps / 10} us",
    )  # fmt: skip
    return build_case(read_scene("fig4", settings))


def _own_cost(bodies: int, steps: int) -> float:
    chain = arrays_of(_compressed_chain(bodies, steps).chain)
    return best_time(lambda: integrate_verlet(chain, 1e-7, steps, 2)) / bodies / steps * 1e9
