"""The in-repo Verlet in three dimensions: what its deck carries beside a straight chain's, and its output."""

from pathlib import Path
from typing import Any

import numpy as np

from drivers.base.errors import InputProblem
from drivers.chain.case import Case
from drivers.chain.lateral import Lateral
from drivers.chain.trace import Sideways, Trace, make_sideways_trace
from drivers.engines._arrays import load_array
from drivers.engines._sums import towards_axis

COLUMNS = 13  # force along the axis; the bore's, place, velocity, spin: three each


def values_of(case: Case, lateral: Lateral) -> dict[str, Any]:
    """What the deck has beside; one row of three for each body."""
    chain, bore = case.chain, lateral.bore
    nowhere = np.zeros(chain.bodies)
    return {
        "place_m": np.column_stack([lateral.offset_m, chain.height_m]).tolist(),
        "velocity_xyz_m_s": np.column_stack([lateral.velocity_m_s, chain.velocity_m_s]).tolist(),
        "wall_m": chain.wall_height_m,
        "shear_N_m-3/2": lateral.shear_stiffness.tolist(),
        "friction": lateral.friction,
        "bore_m": bore.radius_m if bore else 0.0,
        "bore_stiffness_N_m-3/2": (bore.stiffness if bore else nowhere).tolist(),
        "bore_shear_N_m-3/2": (bore.shear_stiffness if bore else nowhere).tolist(),
        "bore_friction": bore.friction if bore else 0.0,
        "turns": lateral.turns,
    }


def refusal(case: Case) -> InputProblem | None:
    """A bore of flat sides."""
    bore = case.chain.bore
    if bore is None or bore.sides is None:
        return None
    return "tube.sides", str(bore.sides), "a true cylinder: leave them out"


def read(case: Case, lateral: Lateral, folder: Path) -> Trace:
    """The array as a trace.

    Raises:
        RunError: the file or part of it is missing.
    """
    columns = load_array(folder / "chain.npy", (COLUMNS, case.scene.samples, case.chain.bodies))
    bore, place, velocity, spin = np.moveaxis(columns[1:].reshape(4, 3, *columns.shape[1:]), 1, 3)
    sideways = Sideways(place[:, :, :2], velocity[:, :, :2], spin, towards_axis(place[:, :, :2], bore[:, :, :2]))
    friction = bore[:, :, 2].sum(axis=1) if lateral.bore else None
    return make_sideways_trace(
        case.chain, case.sample_times_s, columns[0], place[:, :, 2], velocity[:, :, 2], friction, sideways
    )
