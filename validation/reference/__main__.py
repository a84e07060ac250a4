"""``python -m validation.reference chain.json``: integrates the chain of a deck and writes ``chain.npy``.

With ``-`` in place of the deck it runs many decks: each line of the standard input is ``FOLDER WORD``. It runs the deck
of the folder and then prints the word.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np

from validation.reference.deck import integrate_deck

_compiled: set[str] = set()


def main(deck: Path) -> None:
    """Runs one deck and writes the output into the folder of the deck."""
    values = json.loads(deck.read_text())
    method = "tube" if "place_m" in values else values["method"]
    if method not in _compiled:  # compiling does not count as time of the time loop
        integrate_deck(values | {"steps_per_sample": 1}, samples=2)
        _compiled.add(method)
    start = time.perf_counter()
    columns = integrate_deck(values)
    seconds = time.perf_counter() - start
    np.save(deck.with_suffix(".npy"), columns)
    print(f"completed {values['samples']} samples in {seconds:.6f} s")


if __name__ == "__main__":
    if sys.argv[1] == "-":
        for line in sys.stdin:
            folder, word = line.rstrip("\n").split(" ")
            if folder:
                main(Path(folder, "chain.json"))
            print(word, flush=True)
    else:
        main(Path(sys.argv[1]))
