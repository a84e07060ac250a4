"""Adapter of ``leapfrog.c``, a code that reads a deck of numbers: an example of an engine of one's own."""

from pathlib import Path

import numpy as np

from drivers.base.decks import Deck, exact, render
from drivers.base.errors import RunError
from drivers.base.processes import line_of
from drivers.chain.case import Case
from drivers.chain.schemes import heights_and_reach
from drivers.chain.trace import Trace, make_trace
from drivers.engines import Engine

COMMAND = ("leapfrog", "chain.txt", "chain.out")


def deck_of(case: Case) -> Deck:
    """Render ``chain.txt``; its first line is the command."""
    chain, scene = case.chain, case.scene
    height, reach = heights_and_reach(case)
    columns = (chain.mass_kg, height, chain.velocity_m_s, chain.load_N, chain.stiffness, reach)
    bodies = (" ".join(map(exact, body)) for body in np.column_stack(columns))
    timing = f"{exact(scene.time_step_s)} {scene.steps_per_sample} {scene.samples} {chain.bodies}"
    lines = (f"# {' '.join(COMMAND)}", timing, *bodies, "")
    return Deck({"chain.txt": "\n".join(lines)}, COMMAND, raw=("chain.out",))


def read(case: Case, folder: Path) -> Trace:
    """Read the lines of the samples; of a run that ended early those that are complete are its ``partial``."""
    chain, path = case.chain, folder / "chain.out"
    if not path.exists():
        raise RunError(f"no output: {path.name} was not written")
    lines = [line.split() for line in path.read_text(errors="replace").splitlines()]
    complete = [line for line in lines if len(line) == 3 * chain.bodies]
    try:
        values = np.array(complete[: case.scene.samples], float).reshape(-1, chain.bodies, 3)
    except ValueError as error:
        raise RunError(f"output is damaged: {error}") from error
    times = case.sample_times_s[: len(values)]
    trace = make_trace(chain, times, values[:, :, 2], values[:, :, 0], values[:, :, 1]) if len(values) else None
    if len(lines) != case.scene.samples or len(complete) != len(lines):
        raise RunError(f"output ends in sample {len(values) + 1} of {case.scene.samples}", partial=trace)
    assert trace is not None
    return trace


ENGINE = Engine(
    how_to_get="cc -O2 -o leapfrog leapfrog.c -lm",
    program="leapfrog",
    version=lambda command: line_of(command, "--version", r"^leapfrog [0-9]"),  # of any wrong command line
    render=deck_of,
    read=read,
    server=Deck({"serve.sh": render("serve.sh")}, ("sh", "serve.sh", *COMMAND), raw=()),
    loop_pattern=r"^loop of ([0-9.]+) s$",
    dissipation=frozenset(),
    models=frozenset({"gravity", "wall", "striker", "precompression", "sensor masses", "mass scatter"}),
)
