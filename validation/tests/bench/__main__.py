"""``python -m validation.tests.bench``: prints all costs and writes ``results/bench.csv``."""

from drivers.base import paths
from validation.tests.bench.bench import ALL, write

if __name__ == "__main__":
    write((row for measure in ALL for row in measure()), paths.RESULTS / "bench.csv")
