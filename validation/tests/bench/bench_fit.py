"""Cost of fits to the data quoted by the paper, on one core, by the in-repo exact motion."""

import time

from validation.calibration.data_sets import paper_data
from validation.calibration.outcome import solve
from validation.calibration.problem import pose

MODULUS, RESTITUTION = "materials.ptfe.youngs_modulus", "contact.restitution"
ALL_SETS = ("fig4", "table1", "fig5")
FITS = (
    ("two parameters on Fig. 4", ("fig4",), (MODULUS, RESTITUTION)),
    ("two parameters on all quoted data", ALL_SETS, (MODULUS, RESTITUTION)),
    (
        "four parameters on all quoted data",
        ALL_SETS,
        (MODULUS, RESTITUTION, "sensor.time_constant", "chain.mass=0.1 g..0.15 g"),
    ),
)


def bench_fit() -> None:
    """Print the times of fits alone, and with profiles and predictions without each datum."""
    print(f"\n{'fit, one core':<36} {'alone':>8} {'with profiles and predictions':>30}")
    for words, sets, free in FITS:
        took = []
        for quick in (True, False):
            problem, began = pose(paper_data(sets, ()), free), time.perf_counter()
            solve(problem, quick=quick)
            took.append(time.perf_counter() - began)
        print(f"{words:<36} {took[0]:6.1f} s {took[1]:28.1f} s")
