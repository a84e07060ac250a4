"""What post-processing needs to know of a chain, beside the force trace."""

from dataclasses import dataclass
from typing import Any

from drivers.chain.chain import Chain, moving_at_start
from drivers.scene.model import Scene


@dataclass(frozen=True)
class SensorBead:
    """A bead that carries a gauge, counted from the wall; its height is that at time 0."""

    from_wall: int
    height_m: float
    diameter_m: float


@dataclass(frozen=True)
class Layout:
    """Which contacts there are and where the sensors sit.

    Attributes:
        sensors: from the top bead towards the wall: the order in which a wave meets them.
        load_N: sum of all weights and of the precompression, upwards positive.
        moving_N_s: momenta of all bodies at time 0 without their directions.
        damped: whether contacts lose energy in impacts.
        slips: whether they have friction.
        time_constant_s: of the electronics behind the gauges; None: they show the force itself.
    """

    sensors: tuple[SensorBead, ...]
    wall: bool
    striker: bool
    load_N: float
    moving_N_s: float = 0.0
    damped: bool = False
    slips: bool = False
    time_constant_s: float | None = None


def make_layout(scene: Scene, chain: Chain) -> Layout:
    """The layout of a scene's chain."""
    places = sorted((sensor.from_wall for sensor in scene.chain.sensors), reverse=True)
    sensors = tuple(
        SensorBead(place, float(chain.height_m[place - 1]), float(2 * chain.radius_m[place - 1])) for place in places
    )
    constant = scene.sensor.time_constant if scene.sensor else None
    return Layout(
        sensors=sensors,
        wall=chain.wall is not None,
        striker=scene.striker is not None,
        load_N=float(chain.load_N.sum()),
        moving_N_s=moving_at_start(chain),
        damped=chain.damping_ratio > 0,
        slips=chain.slips,
        time_constant_s=constant,
    )


def read_layout(stored: dict[str, Any]) -> Layout:
    """A layout as a run record holds it; older records know of no electronics."""
    sensors = tuple(SensorBead(**sensor) for sensor in stored["sensors"])
    return Layout(**(stored | {"sensors": sensors}))
