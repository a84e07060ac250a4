"""Rules between the parts of a scene; those on single values stand in the model itself."""

from collections.abc import Iterator
from math import acos, ceil, pi

from drivers.base.errors import InputProblem
from drivers.base.messages import shorten
from drivers.scene.model import POWER, RIGID, VISCOELASTIC, Bead, Contact, Measured, Scene, SceneFile, Sensor

ROUNDED = 1e-6  # of the play, the difference of two diameters
LAWS = {VISCOELASTIC: ("restitution", "damping_ratio"), POWER: ("gamma", "alpha")}  # of dissipation, and their keys


def choices(file: SceneFile) -> Iterator[InputProblem]:
    """Keys of which a scene gives one."""
    run = file.run
    if RIGID in file.materials:
        yield f"materials.{RIGID}", "constants of its own", f'another name: "{RIGID}" is the wall that does not yield'
    if (run.time_step is None) == (run.accuracy is None):
        found = "neither time_step nor accuracy" if run.time_step is None else "both time_step and accuracy"
        yield "run", found, "exactly one of the two"
    yield from _dissipation(file.contact)
    for i, measured in enumerate(file.measured):
        yield from _measured_choices(measured, f"measured.{i}")


def _dissipation(contact: Contact) -> Iterator[InputProblem]:
    """Keys of one law of dissipation beside those of another."""
    own = {law: [key for key in keys if getattr(contact, key) is not None] for law, keys in LAWS.items()}
    for law, keys in own.items():
        if law != contact.dissipation:
            for key in keys:
                found = f'{getattr(contact, key):g} with a dissipation that is "{contact.dissipation}"'
                yield f"contact.{key}", found, f'no such key, or contact.dissipation = "{law}"'
    if len(own[VISCOELASTIC]) == 2:
        yield "contact", "both restitution and damping_ratio", "one of the two: either gives the other"
    if contact.dissipation == POWER and contact.gamma is None:
        yield "contact.gamma", "nothing", "a number of 0 or more, in N (s/m)^alpha"


def _measured_choices(measured: Measured, key: str) -> Iterator[InputProblem]:
    """Keys of a measured trace, or else of quoted values."""
    if (measured.file is None) == (measured.values is None):
        yield key, "neither file nor values" if measured.file is None else "both file and values", "exactly one of both"
    if measured.file is not None and measured.errors is not None:
        yield f"{key}.errors", "errors of a file's readings", "gain_uncertainty and noise, or values in place of file"
    if measured.values is not None:
        for strange in sorted(measured.model_fields_set - {"values", "errors", "gain_uncertainty", "source"}):
            yield f"{key}.{strange}", "a key of a file beside values", "values, errors, gain_uncertainty, source"
        if not measured.values:
            yield f"{key}.values", "nothing", "one or more observables"
        errors = measured.errors or {}
        for name in measured.values:
            if name not in errors:
                yield f"{key}.errors.{name}", "nothing", "the relative standard error of the value"
        for name in errors:
            if name not in measured.values:
                yield f"{key}.errors.{name}", "an error without a value", shorten(", ".join(measured.values))
    if measured.gauges is not None and not measured.gauges:
        yield f"{key}.gauges", "nothing", 'a heading by gauge, such as { wall = "CH1" }'


def contradictions(scene: Scene) -> Iterator[InputProblem]:
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
                allowed = f"1 to {count}, the chain's beads" if count else "none: the chain has no beads"
                yield key, str(entry.from_wall), allowed
            if entry.from_wall in seen:
                yield key, f"{entry.from_wall} twice", "each bead once"
            seen.add(entry.from_wall)
    weighed = {bead.from_wall for bead in chain.bead if bead.mass is not None}
    for i, sensor in enumerate(chain.sensors):
        if sensor.mass is not None and sensor.from_wall in weighed:
            found = f"a mass for bead {sensor.from_wall} here and in chain.bead"
            yield f"chain.sensors.{i}.mass", found, "one of the two"
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
        material = bead.material or chain.material
        if unlike and scene.materials[material].density is None:
            yield f"chain.bead.{i}.mass", "nothing", f"a mass, or a density in [materials.{material}]"
    widest = max([chain.diameter, *(bead.diameter for bead in chain.bead if bead.diameter)])
    if tube is not None and count and tube.inner_diameter < widest:
        yield "tube.inner_diameter", f"{tube.inner_diameter:g} m", f"at least the beads' {widest:g} m"
    if scene.three_dimensional:
        yield from _tube_contradictions(scene, widest)


def _striker_contradictions(scene: Scene) -> Iterator[InputProblem]:
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


def _tube_contradictions(scene: Scene, widest: float) -> Iterator[InputProblem]:
    """What of a three-dimensional scene does not go together."""
    chain, tube, offset = scene.chain, scene.tube, scene.chain.lateral_offset
    if scene.contact.gamma:
        allowed = '"viscoelastic": the power law is for straight chains'
        yield "contact.dissipation", '"power" for beads that move sideways', allowed
    if scene.run.accuracy is not None:
        allowed = "a run.time_step: the exact motion is known of straight chains only"
        yield "run.accuracy", "an accuracy for beads that move sideways", allowed
    if tube is None:
        if offset is not None:
            yield "chain.lateral_offset", f"{offset:g} m without a tube", "a [tube] to hold the beads"
        return
    if chain.count == 0:
        yield "chain.count", "0 with beads to move sideways", "1 or more"
        return
    play = (tube.inner_diameter - widest) / 2
    if play <= 0:
        yield "tube.inner_diameter", f"{tube.inner_diameter:g} m", f"more than the beads' {widest:g} m"
    elif offset is not None and offset > play * (1 + ROUNDED):
        yield "chain.lateral_offset", f"{offset:g} m", f"at most the play of {play:.4g} m"
    elif tube.sides is not None:  # edges are off the bore by its play at most: R (1 / cos(pi / n) - 1) <= play
        radius = tube.inner_diameter / 2
        least = ceil(pi / acos(radius / (radius + play)))
        if tube.sides < least:
            allowed = f"at least {least}: the edges of fewer lie off the bore by more than its play"
            yield "tube.sides", str(tube.sides), allowed
