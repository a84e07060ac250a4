"""``python -m validation.reference chain.json``: integrates the chain of a deck and writes ``chain.npz``."""

import json
import sys
import time
from pathlib import Path

import numpy as np

from validation.reference.hertz_chain import HertzChain, Motion


def main(deck: Path) -> None:
    """Runs one deck; its output goes beside it."""
    values = json.loads(deck.read_text())
    chain = HertzChain(
        mass_kg=values["mass_kg"],
        stiffness=values["stiffness_N_m-3/2"],
        overlap_m=values["overlap_m"],
        velocity_m_s=values["velocity_m_s"],
        load_N=values["load_N"],
    )
    method, step_s, every, samples = (values[key] for key in ("method", "time_step_s", "steps_per_sample", "samples"))
    _integrate(chain, method, step_s, 1, 2)  # compiles, or loads what is compiled: no part of the time loop
    start = time.perf_counter()
    motion = _integrate(chain, method, step_s, every, samples)
    seconds = time.perf_counter() - start
    np.savez(
        deck.with_suffix(".npz"),
        force=motion.force_N,
        displacement=motion.displacement_m,
        velocity=motion.velocity_m_s,
    )
    print(f"completed {values['samples']} samples in {seconds:.6f} s")


def _integrate(chain: HertzChain, method: str, time_step_s: float, every: int, samples: int) -> Motion:
    if method == "verlet":
        from validation.reference.verlet import integrate_verlet

        return integrate_verlet(chain, time_step_s, every, samples)
    from validation.reference.adaptive import integrate_adaptive

    return integrate_adaptive(chain, np.arange(samples, dtype=float) * (every * time_step_s))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
