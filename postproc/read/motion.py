"""Chain, positions and velocities of a finished run."""

from dataclasses import replace

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.chain import Chain, build_chain
from drivers.chain.lateral_start import with_lateral
from drivers.chain.trace import FORCES, STATE, State, Trace, read_state
from drivers.run.finished import EndedRun
from drivers.scene.model import Scene
from drivers.scene.read_scene import stored_scene


def chain_of(run: EndedRun) -> tuple[Scene, Chain]:
    """The scene of a run and its chain at time 0.

    Raises:
        InputError: The record is damaged, or the forces belong to other bodies.
    """
    try:
        scene = stored_scene(run.record.scene)
        chain = with_lateral(scene, build_chain(scene))
        if not np.isfinite([*chain.mass_kg, *chain.stiffness, *chain.velocity_m_s, *chain.load_N]).all():
            raise ValueError("masses, stiffnesses, velocities or loads that are no numbers")
    except (TypeError, LookupError, AttributeError, ValueError, ArithmeticError) as error:
        raise InputError(paths.shown(run.folder), "run.json", "a damaged scene", "the record of a run") from error
    contacts = run.trace.force_N.shape[1]
    if contacts != chain.bodies:
        found = f"forces of {contacts} contacts"
        raise InputError(paths.shown(run.folder / FORCES), "", found, f"the {chain.bodies} of the run's scene")
    return scene, chain


def read_motion(run: EndedRun) -> State:
    """Positions and velocities of a run, bit for bit.

    Raises:
        InputError: The run has none, they are damaged, or their times differ from those of the forces.
    """
    path, record = run.folder / STATE, run.record
    if not path.is_file():
        name = record.scene_name
        scene = name if (paths.SCENES / f"{name}.toml").is_file() else f"{name}.toml"
        again = f"""beads run {scene} --engine {record.engine} --set run.record='["forces", "state"]'"""
        raise InputError(
            paths.shown(path),
            "",
            f"file not found: the run kept no positions; this command makes a run with positions: {again}",
        )
    try:
        found = read_state(path, record.bodies)
    except KeyError as error:
        raise InputError(paths.shown(path), str(error.args[0]), "missing column") from error
    except Exception as error:  # a damaged file can make pyarrow raise almost anything
        raise InputError(paths.shown(path), "", "a damaged file", "a run's own (run it again with --rerun)") from error
    if not np.array_equal(found.time_s, run.trace.time_s):
        raise InputError(paths.shown(path), "time_s", "other times", f"the times of {FORCES}")
    if not (np.isfinite(found.place_m).all() and np.isfinite(found.velocity_m_s).all()):
        raise InputError(paths.shown(path), "", "values that are not finite", "the positions of a run that is done")
    return found


def trace_with_state(run: EndedRun) -> Trace:
    """Trace of a run with heights and axial velocities, if the run recorded them.

    Raises:
        InputError: a file is missing or damaged.
    """
    if not (run.folder / STATE).is_file():
        return run.trace
    motion = read_motion(run)
    return replace(run.trace, height_m=motion.place_m[:, :, 2], velocity_m_s=motion.velocity_m_s[:, :, 2])


def spread(samples: int, frames: int) -> list[int]:
    """Indices of ``frames`` samples spread evenly over a run, with both ends; all samples if there are fewer."""
    return [int(place) for place in np.unique(np.linspace(0, samples - 1, min(frames, samples)).round())]
