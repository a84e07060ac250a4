"""The scene of a finished run, as its record holds it."""

from typing import Any

from drivers.scene.model import Bead, Chain, Contact, Gauge, Material, Part, Run, Scene, Sensor, Striker, Tube, Wall

PARTS: dict[str, type[Part]] = {"striker": Striker, "wall": Wall, "tube": Tube, "contact": Contact, "sensor": Gauge}


def stored_scene(stored: dict[str, Any]) -> Scene:
    """The scene of ``run.json``: in SI units and checked before it ran, so taken as it is.

    Raises:
        TypeError, KeyError, AttributeError: it is no such scene.
    """
    chain = dict(stored["chain"])
    chain["sensors"] = tuple(Sensor.model_construct(**sensor) for sensor in chain.get("sensors", ()))
    chain["bead"] = tuple(Bead.model_construct(**bead) for bead in chain.get("bead", ()))
    run = stored["run"]
    tables: dict[str, Any] = {
        name: part.model_construct(**stored[name]) for name, part in PARTS.items() if name in stored
    }
    tables |= {
        "chain": Chain.model_construct(**chain),
        "run": Run.model_construct(**(run | {"record": tuple(run["record"])})),
        "materials": {name: Material.model_construct(**own) for name, own in stored["materials"].items()},
    }
    kept = {name: value for name, value in stored.items() if name != "units"}
    return Scene.model_construct(**(kept | tables | {"file": stored["name"]}))
