"""``python -m validation.reference chain.json``: integrates the chain of a deck and writes ``chain.npy``.

With ``-`` in place of the deck it runs many decks: each line of the standard input is ``FOLDER WORD``. It runs the deck
of the folder and then prints the word. Without a deck it compiles all integrators, whose code is then kept.
"""

import json
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from validation.reference import columns_of, timed
from validation.reference.adaptive import integrate_adaptive
from validation.reference.hertz_chain import HertzChain, TubeChain
from validation.reference.symplectic import integrate_symplectic
from validation.reference.tube import integrate_tube
from validation.reference.velocity_verlet import follow_verlet, integrate_verlet, integrate_verlet_absolute

TIMES_S = np.array([0.0, 1e-3])


def main(deck: Path) -> None:
    """Runs one deck and writes the output into the folder of the deck."""
    values = json.loads(deck.read_text())
    motion, seconds = timed(values)
    np.save(deck.with_suffix(".npy"), columns_of(motion))
    print(f"completed {values['samples']} samples in {seconds:.6f} s")


def _compile_elastic(chain: HertzChain) -> None:
    integrate_verlet(chain, 1e-3, 1, 2)
    follow_verlet(chain, 1e-3, 1)
    integrate_adaptive(chain, TIMES_S)
    integrate_verlet_absolute(chain, chain.mass_kg, chain.mass_kg, 1e-3, 1, 2)
    integrate_symplectic(chain, 1e-3, 1, 2)


def _compile_others(chain: HertzChain) -> None:
    one, along = chain.mass_kg, np.outer(TIMES_S, (0.0, 0.0, 1.0))
    power = HertzChain(one, one, 0 * one, -TIMES_S, 0 * one, one, 1.5)
    integrate_verlet(chain, 1e-3, 1, 2, energies=True)
    integrate_verlet_absolute(power, one, one, 1e-3, 1, 2)
    integrate_tube(TubeChain(*8 * (one,), along, -along, -1.0, 0.1, 2.0, 0.1), 1e-3, 1, 2)


def compile_all() -> None:
    """Compiles every integrator for every contact law, by integrations of two bodies in two processes."""
    one = np.ones(2)
    chain = HertzChain(one, one, 0 * one, -TIMES_S, 0 * one)
    with ProcessPoolExecutor(2) as pool:
        for compiled in [pool.submit(part, chain) for part in (_compile_elastic, _compile_others)]:
            compiled.result()


if __name__ == "__main__":
    if not sys.argv[1:]:
        compile_all()
    elif sys.argv[1] == "-":
        for line in sys.stdin:
            folder, word = line.rstrip("\n").split(" ")
            if folder:
                main(Path(folder, "chain.json"))
            print(word, flush=True)
    else:
        main(Path(sys.argv[1]))
