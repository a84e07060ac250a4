"""Chain of a finished run, and its trace with positions."""

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.chain import Chain, build_chain
from drivers.chain.trace import Trace
from drivers.run.run_folder import EndedRun
from drivers.scene.model import Scene
from drivers.scene.read_scene import stored_scene


def chain_of(run: EndedRun) -> tuple[Scene, Chain]:
    """The scene of a run and its chain at time 0.

    Raises:
        InputError: The scene of the record is that of another version.
    """
    try:
        scene = stored_scene(run.record.scene)
        chain = build_chain(scene)
        if scene.three_dimensional:
            from drivers.chain.lateral import with_lateral  # imports scipy

            chain = with_lateral(scene, chain)
        if not np.isfinite([*chain.mass_kg, *chain.stiffness, *chain.velocity_m_s, *chain.load_N]).all():
            raise ValueError("masses, stiffnesses, velocities or loads that are no numbers")
    except (TypeError, LookupError, AttributeError, ValueError, ArithmeticError) as error:
        raise InputError(
            paths.shown(run.folder), "scene", "a record of another version", "the record of a run"
        ) from error
    return scene, chain


def trace_with_state(run: EndedRun) -> Trace:
    """Trace of a run with positions and velocities, if the run recorded them.

    Raises:
        InputError: a file is missing or damaged.
    """
    return run.state if run.has_state else run.trace


def spread(samples: int, frames: int) -> list[int]:
    """Indices of ``frames`` samples spread evenly over a run, with both ends; all samples if there are fewer."""
    return [int(place) for place in np.unique(np.linspace(0, samples - 1, min(frames, samples)).round())]
