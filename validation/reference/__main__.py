"""``python -m validation.reference chain.json``: integrates the chain of a deck and writes ``chain.npy``.

With ``-`` in place of the deck it runs many decks: each line of the standard input is ``FOLDER WORD``. It runs the deck
of the folder and then prints the word. Further arguments name kernel modules to load first.
"""

import json
import sys
import time
from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from validation.reference.hertz_chain import TUBE_KEYS, Array, HertzChain, TubeChain

Integration = Callable[[int, int], list[Array]]  # arguments: number of samples, steps per sample

_compiled: set[str] = set()


def main(deck: Path) -> None:
    """Runs one deck and writes the output into the folder of the deck."""
    values = json.loads(deck.read_text())
    method, integrate = ("tube", _tube(values)) if "place_m" in values else (values["method"], _straight(values))
    if method not in _compiled:  # compiling does not count as time of the time loop
        integrate(2, 1)
        _compiled.add(method)
    start = time.perf_counter()
    columns = integrate(values["samples"], values.get("steps_per_sample", 1))
    seconds = time.perf_counter() - start
    np.save(deck.with_suffix(".npy"), columns)
    print(f"completed {values['samples']} samples in {seconds:.6f} s")


def _straight(values: dict[str, Any]) -> Integration:
    """Integration of a straight chain."""
    keys = ("mass_kg", "stiffness_N_m-3/2", "overlap_m", "velocity_m_s", "load_N")
    damping = values.get("gamma_N_(s/m)^alpha", values.get("damping_N_s_m-5/4", []))
    mass, stiffness, overlap, velocity, load = (values[key] for key in keys)
    chain = HertzChain(mass, stiffness, overlap, velocity, load, damping, values.get("alpha", 0.0))

    def integrate(samples: int, steps_per_sample: int) -> list[Array]:
        if values["method"] == "verlet":
            from validation.reference.velocity_verlet import integrate_verlet

            motion = integrate_verlet(chain, values["time_step_s"], steps_per_sample, samples)
        else:
            from validation.reference.adaptive import integrate_adaptive

            times = np.arange(samples, dtype=float) * values["sample_interval_s"]
            motion = integrate_adaptive(chain, times, values["tolerance"])
        return [motion.force_N, motion.displacement_m, motion.velocity_m_s]

    return integrate


def _tube(values: dict[str, Any]) -> Integration:
    """Integration of a three-dimensional chain."""
    from validation.reference.tube import integrate_tube

    chain = TubeChain(
        mass_kg=values["mass_kg"],
        radius_m=np.array([np.inf if diameter is None else diameter / 2 for diameter in values["diameter_m"]]),
        stiffness=values["stiffness_N_m-3/2"],
        damping=values.get("damping_N_s_m-5/4", np.zeros(len(values["mass_kg"]))),
        load_N=values["load_N"],
        **{field: values[key] for field, key in TUBE_KEYS.items()},
    )

    def integrate(samples: int, steps_per_sample: int) -> list[Array]:
        motion = integrate_tube(chain, values["time_step_s"], steps_per_sample, samples)
        triples = (motion.bore_N, motion.place_m, motion.velocity_m_s, motion.spin_rad_s)
        return [motion.force_N, *(column for triple in triples for column in np.moveaxis(triple, 2, 0))]

    return integrate


def serve(requests: Iterable[str], kernels: Iterable[str]) -> None:
    """Runs the decks of all requests; a deck that fails ends the process, as it does in a separate process."""
    for name in kernels:
        import_module(f"validation.reference.{name}")
    for line in requests:
        folder, word = line.rstrip("\n").split(" ")
        if folder:
            main(Path(folder, "chain.json"))
        print(word, flush=True)


if __name__ == "__main__":
    if sys.argv[1] == "-":
        serve(sys.stdin, sys.argv[2:])
    else:
        main(Path(sys.argv[1]))
