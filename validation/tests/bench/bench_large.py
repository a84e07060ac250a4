"""Seconds and memory of runs of very long chains, in the engine and around it: decks, checks, errors, files."""

import resource
import subprocess
import tempfile
import time
from pathlib import Path

from drivers.engines import installed
from drivers.run.run_folder import record_of
from validation.tests.helpers.commands import BEADS, beads

RUNS = {("lammps", 100_000): 500, ("liggghts", 100_000): 500, ("verlet", 100_000): 500, ("verlet", 1_000_000): 50}


def bench_large() -> None:
    """Print a line for each run of a struck chain with 6 samples."""
    print(
        "\nbeads run of very long chains, 6 samples: wall seconds of the engine, of all else, memory of all processes"
    )
    for (engine, bodies), steps in RUNS.items():
        if not installed([engine]):
            print(f"{engine}: not installed, not run")
            continue
        interval = f"{steps / 50} us"
        keys = [f"chain.count={bodies - 1}", f"chain.sensors=[{{ from_wall = {bodies - 9} }}]", "run.time_step=0.1 us"]
        keys += [f"run.sample_interval={interval}", f"run.duration={steps / 10} us"]
        with tempfile.TemporaryDirectory() as runs:
            beads("run", "fig4", "--engine", engine, "--runs", runs)  # checks the build, once
            began = time.perf_counter()
            words = [word for key in keys for word in ("--set", key)]
            done = subprocess.run(
                [*BEADS, "run", "long-chain", "--engine", engine, "--runs", runs, *words],
                capture_output=True, text=True, check=True,
            )  # fmt: skip
            wall_s = time.perf_counter() - began
            engine_s = record_of(Path(done.stdout.strip())).wall_s or 0.0
        most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e6
        print(
            f"{engine:>9} {bodies:>8} bodies {engine_s:6.2f} s {wall_s - engine_s:6.2f} s, at most {most:.2f} GB so far"
        )
