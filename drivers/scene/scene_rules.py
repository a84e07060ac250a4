"""Rules between the parts of a scene; those on single values stand in the model itself."""

from collections.abc import Iterator

import numpy as np

from drivers.base.messages import Complaint, shorten
from drivers.chain.chain import Chain
from drivers.scene.model import RIGID, Bead, Scene, SceneFile, Sensor
from drivers.scene.tube_rules import tube_contradictions

MAX_OVERLAP = 0.5  # of the radius, at rest: far beyond Hertz, and close to where engines lose a contact


def choices(file: SceneFile) -> Iterator[Complaint]:
    """Keys of which a scene gives one."""
    run = file.run
    if RIGID in file.materials:
        yield f"materials.{RIGID}", "constants of its own", f'another name: "{RIGID}" is the wall that does not yield'
    if (run.time_step is None) == (run.accuracy is None):
        found = "neither time_step nor accuracy" if run.time_step is None else "both time_step and accuracy"
        yield "run", found, "exactly one of the two"
    if file.contact.restitution is not None and file.contact.damping_ratio is not None:
        yield "contact", "both restitution and damping_ratio", "one of the two: either gives the other"


def contradictions(scene: Scene) -> Iterator[Complaint]:
    """Parts of the scene that do not go together."""
    chain, striker, wall, tube = scene.chain, scene.striker, scene.wall, scene.tube
    count = chain.count
    if "forces" not in scene.run.record:
        yield "run.record", shorten(list(scene.run.record)), 'a list with "forces" in it'
    lists: dict[str, tuple[Sensor | Bead, ...]] = {"sensors": chain.sensors, "bead": chain.bead}
    for what, entries in lists.items():
        seen: set[int] = set()
        for i, entry in enumerate(entries):
            key = f"chain.{what}.{i}.from_wall"
            if entry.from_wall > count:
                yield (
                    key,
                    str(entry.from_wall),
                    f"1 to {count}, the chain's beads" if count else "none: the chain has no beads",
                )
            if entry.from_wall in seen:
                yield key, f"{entry.from_wall} twice", "each bead once"
            seen.add(entry.from_wall)
    weighed = {bead.from_wall for bead in chain.bead if bead.mass is not None}
    for i, sensor in enumerate(chain.sensors):
        if sensor.mass is not None and sensor.from_wall in weighed:
            yield (
                f"chain.sensors.{i}.mass",
                f"a mass for bead {sensor.from_wall} here and in chain.bead",
                "one of the two",
            )
    if count == 0:
        if striker is None or wall is None:
            yield "chain.count", "0", "1 or more, unless a striker meets a wall"
        if chain.precompression:
            yield "chain.precompression", f"{chain.precompression:g} N", "nothing: there is no top bead to press on"
    if striker is not None:
        yield from _striker_contradictions(scene)
    if count and chain.mass is None and scene.materials[chain.material].density is None:
        yield "chain.mass", "nothing", f"a mass, or a density in [materials.{chain.material}]"
    for i, bead in enumerate(chain.bead):
        unlike = bead.mass is None and (bead.material is not None or bead.diameter is not None)
        if unlike and scene.materials[bead.material or chain.material].density is None:
            yield (
                f"chain.bead.{i}.mass",
                "nothing",
                f"a mass, or a density in [materials.{bead.material or chain.material}]",
            )
    if tube is not None:
        widest = max([chain.diameter, *(bead.diameter for bead in chain.bead if bead.diameter)])
        if count and tube.inner_diameter < widest:
            yield "tube.inner_diameter", f"{tube.inner_diameter:g} m", f"at least the beads' {widest:g} m"
    yield from tube_contradictions(scene)


def _striker_contradictions(scene: Scene) -> Iterator[Complaint]:
    striker = scene.striker
    assert striker is not None
    if striker.shape == "flat":
        if striker.diameter is not None:
            yield "striker.diameter", f"{striker.diameter:g} m", "nothing: a flat striker has no diameter"
        if striker.mass is None:
            yield "striker.mass", "nothing", "a mass: a flat striker has no volume to take it from"
        if scene.chain.count == 0:
            yield "striker.shape", '"flat"', '"sphere": a flat striker on a flat wall is no Hertz contact'
        return
    if striker.diameter is None:
        yield "striker.diameter", "nothing", "the diameter of the sphere"
    if striker.mass is None and scene.materials[striker.material].density is None:
        yield "striker.mass", "nothing", f"a mass, or a density in [materials.{striker.material}]"


def impossible(scene: Scene, chain: Chain) -> Iterator[Complaint]:
    """What shows only in the chain as built: masses drawn below zero, beads pressed into each other."""
    if (chain.mass_kg <= 0).any():
        place = int(np.argmin(chain.mass_kg)) + 1
        yield "chain.mass_scatter", f"{scene.chain.mass_scatter:g} kg, which leaves bead {place} no mass", "less"
    deepest = chain.overlap_m / chain.smaller_radius_m
    if (deepest > MAX_OVERLAP).any():
        contact = int(np.argmax(deepest)) + 1
        key = "chain.precompression" if chain.precompression_N else "gravity"
        found = f"a load that presses {chain.overlap_m[contact - 1]:g} m deep at contact {contact}"
        yield key, found, f"overlaps of at most {MAX_OVERLAP:g} of the radius"
