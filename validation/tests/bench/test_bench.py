"""Every function of the benchmarks on small sizes, so that none rots; times are not judged."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from validation.tests.bench import bench
from validation.tests.bench.bench import ALL, COLUMNS, Row, write

SMALL: dict[Callable[..., Iterator[Row]], tuple[Any, ...]] = {
    bench.reference: ({("fig4", "run.duration=50 us"): (1e-4,), ("long-chain", "run.duration=50 us"): (1e-6,)}, 1, 1),
    bench.steps: ({5: 10}, 1),
    bench.batch: ({("verlet",): 2},),
    bench.fits: ({"speed of Fig. 4": (("fig4",), ("materials.ptfe.youngs_modulus",))},),
    bench.experiments: (("viscoelastic", "kuwabara-kono"), 2),
    bench.commands: ((("--help",), ("compare", "fig4", "--engine", "verlet", "--allow-missing")), 1),
    bench.large: ({("verlet", 50): 50},),
    bench.live: ({10: 3},),
    bench.clone: ("help", ()),
}


@pytest.mark.parametrize(
    "measure",
    [
        *(
            pytest.param(each, marks=[pytest.mark.long] * (each in (bench.batch, bench.experiments)))
            for each in ALL
            if each is not bench.live
        ),
        pytest.param(bench.live, marks=pytest.mark.page),
    ],
)
def test_costs_are_numbers(measure: Callable[..., Iterator[Row]], tmp_path: Path) -> None:
    write(measure(*SMALL[measure]), tmp_path / "bench.csv")
    rows = pd.read_csv(tmp_path / "bench.csv")
    assert (*rows.columns,) == COLUMNS
    assert len(rows) > 0
    assert (np.isfinite(rows["value"]) & (rows["value"] > 0)).all()
