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
    if "place_m" in values:
        _run_tube(deck, values)
        return
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


def _run_tube(deck: Path, values: dict[str, Any]) -> None:
    """Runs the deck of a three-dimensional chain."""
    from validation.reference.tube import integrate_tube
    from validation.reference.tube_chain import TubeChain

    chain = TubeChain(
        mass_kg=values["mass_kg"],
        radius_m=np.array([np.inf if diameter is None else diameter / 2 for diameter in values["diameter_m"]]),
        stiffness=values["stiffness_N_m-3/2"],
        damping=values.get("damping_N_s_m-5/4", np.zeros(len(values["mass_kg"]))),
        shear=values["shear_N_m-3/2"],
        load_N=values["load_N"],
        bore_stiffness=values["bore_stiffness_N_m-3/2"],
        bore_shear=values["bore_shear_N_m-3/2"],
        place_m=values["place_m"],
        velocity_m_s=values["velocity_xyz_m_s"],
        wall_m=values["wall_m"],
        friction=values["friction"],
        bore_m=values["bore_m"],
        bore_friction=values["bore_friction"],
        turns=values["turns"],
    )
    timing = (values["time_step_s"], values["steps_per_sample"])
    if "tube" not in _compiled:
        integrate_tube(chain, *timing, 1)
        _compiled.add("tube")
    start = time.perf_counter()
    motion = integrate_tube(chain, *timing, values["samples"])
    seconds = time.perf_counter() - start
    columns = [motion.force_N]
    for triple in (motion.bore_N, motion.place_m, motion.velocity_m_s, motion.spin_rad_s):
        columns += list(np.moveaxis(triple, 2, 0))
    np.save(deck.with_suffix(".npy"), columns)
    print(f"completed {values['samples']} samples in {seconds:.6f} s")


def serve(requests: Iterable[str]) -> None:
    """Runs deck after deck; one that cannot be run ends it, as it would end a process of its own."""
    import validation.reference.adaptive
    import validation.reference.velocity_verlet  # noqa: F401  before the first request, not in it

    for line in requests:
        folder, word = line.rstrip("\n").split(" ")
        if folder:
            main(Path(folder, "chain.json"))
        print(word, flush=True)


def _integrate(chain: HertzChain, values: dict[str, Any]) -> Motion:
    samples = values["samples"]
    if values["method"] == "verlet":
        from validation.reference.velocity_verlet import integrate_verlet

        return integrate_verlet(chain, values["time_step_s"], values["steps_per_sample"], samples)
    from validation.reference.adaptive import integrate_adaptive

    return integrate_adaptive(chain, np.arange(samples, dtype=float) * values["sample_interval_s"])


if __name__ == "__main__":
    if sys.argv[1] == "-":
        serve(sys.stdin)
    else:
        main(Path(sys.argv[1]))
