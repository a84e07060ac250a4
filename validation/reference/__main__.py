"""``python -m validation.reference chain.json``: integrates the chain of a deck and writes ``chain.npy``.

With ``-`` in place of the deck it serves many: each line of its input names a folder and a word to print afterwards.
"""

import json
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from validation.reference.hertz_chain import HertzChain, Motion

_compiled: set[str] = set()


def main(deck: Path) -> None:
    """Runs one deck; its output goes beside it."""
    values = json.loads(deck.read_text())
    chain = HertzChain(
        mass_kg=values["mass_kg"],
        stiffness=values["stiffness_N_m-3/2"],
        overlap_m=values["overlap_m"],
        velocity_m_s=values["velocity_m_s"],
        load_N=values["load_N"],
        damping=values.get("damping_N_s_m-5/4", []),
    )
    if values["method"] not in _compiled:  # no part of the time loop
        _integrate(chain, values | {"samples": 2, "steps_per_sample": 1})
        _compiled.add(values["method"])
    start = time.perf_counter()
    motion = _integrate(chain, values)
    seconds = time.perf_counter() - start
    np.save(deck.with_suffix(".npy"), [motion.force_N, motion.displacement_m, motion.velocity_m_s])
    print(f"completed {values['samples']} samples in {seconds:.6f} s")


def serve(requests: Iterable[str]) -> None:
    """Runs deck after deck; one that cannot be run ends it, as it would end a process of its own."""
    import validation.reference.adaptive
    import validation.reference.verlet  # noqa: F401  before the first request, not in it

    for line in requests:
        folder, word = line.rstrip("\n").split(" ")
        if folder:
            main(Path(folder, "chain.json"))
        print(word, flush=True)


def _integrate(chain: HertzChain, values: dict[str, Any]) -> Motion:
    samples = values["samples"]
    if values["method"] == "verlet":
        from validation.reference.verlet import integrate_verlet

        return integrate_verlet(chain, values["time_step_s"], values["steps_per_sample"], samples)
    from validation.reference.adaptive import integrate_adaptive

    return integrate_adaptive(chain, np.arange(samples, dtype=float) * values["sample_interval_s"])


if __name__ == "__main__":
    if sys.argv[1] == "-":
        serve(sys.stdin)
    else:
        main(Path(sys.argv[1]))
