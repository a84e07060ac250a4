"""``reference``: the exact motion, by adaptive steps to a tolerance; the error of every run is measured against it."""

from drivers.engines import EXACT, _in_repo

ENGINE = _in_repo.in_repository_engine(
    "adaptive",
    # a tolerance in place of a time step: runs at several steps share a run of the reference
    lambda case: {"tolerance": case.reference_tolerance, "sample_interval_s": case.scene.run.sample_interval},
    scheme=EXACT,
    style={"color": "#b3b3b3", "lw": 3.2, "marker": "o", "ms": 8.0},
)
