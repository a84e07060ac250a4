"""The chains whose limits are measured: the paper's, sweeps over one parameter each, and random ones by number."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import nan
from typing import Any

import numpy as np

from drivers.base import paths
from drivers.chain.case import Case, build_case
from drivers.chain.contact_law import hertz_force
from drivers.limits.energy_bounds import at_most
from drivers.limits.stable_step import reached, stable_step
from drivers.scene.read_scene import make_scene, read_toml
from postproc.paper.simulate import case_of
from validation.accuracy.plan import plan_case

PAPER = ("fig4", "fig5", "fig6b", "fig6d", "table1")
SHIPPED, RANDOM, BOUNCING = "shipped scenes", "random scenes", "impacts"
BASE = "fig4"
# key of the scene, unit, values; by what the axis of a figure says
SWEEPS = {
    "striker speed, m/s": ("striker.speed", "m/s", np.geomspace(1e-6, 50, 12)),
    "Young's modulus, Pa": ("materials.ptfe.youngs_modulus", "Pa", np.geomspace(1e6, 1e12, 9)),
    "striker over bead mass": ("striker.mass", "kg", 0.1226e-3 * np.geomspace(1e-3, 1e3, 9)),
    "Young's modulus of the wall, Pa": ("materials.brass.youngs_modulus", "Pa", np.geomspace(1e6, 1e13, 8)),
}
BEAD_KG = 0.1226e-3
DENSITY = 2200.0  # of random scenes' beads
TRAVERSE = 45.0  # limits that a scene of a sweep lasts: the wave comes to the wall and back, as in the paper's scene


@dataclass(frozen=True)
class Subject:
    """A chain to measure.

    Attributes:
        value: of the parameter that a sweep varies.
        whole_scan: codes are scanned from small steps on, as Verlet is.
    """

    group: str
    name: str
    case: Case
    value: float = nan
    whole_scan: bool = False


def shipped() -> Iterator[Subject]:
    """The paper's scenes and two more."""
    for name in (*PAPER, "low-amplitude", "steel-chain"):
        yield Subject(SHIPPED, name, case_of(name), whole_scan=name in PAPER)


def sweeps() -> Iterator[Subject]:
    """One parameter at a time over decades."""
    for group, (key, unit, values) in SWEEPS.items():
        for value in values:
            setting = f"{key}={value:.6g} {unit}"
            rough = case_of(BASE, setting)
            duration = TRAVERSE * stable_step(rough.chain, at_most(rough.chain, float(rough.sample_times_s[-1])))
            interval = duration / 800
            timing = (f"run.duration={duration:.6g} s", f"run.sample_interval={interval:.6g} s")
            case = case_of(BASE, setting, *timing, f"run.time_step={interval:.6g} s")
            yield Subject(group, f"{BASE} {setting}", case, value / BEAD_KG if unit == "kg" else float(value))


def bouncing() -> Iterator[Subject]:
    """A bead that falls on the wall again and again: errors of impacts add up."""
    for duration_ms in (5, 50, 500):
        settings = ("chain.count=0", "chain.sensors=[]", "gravity=981 m/s^2", "striker.speed=0.5 m/s")
        case = case_of(BASE, *settings, f"run.duration={duration_ms} ms", "run.time_step=1 us")
        impacts = reached(case.chain, float(case.sample_times_s[-1])).impacts
        yield Subject(BOUNCING, f"a bead that bounces {impacts:.0f} times", case, impacts)


def at_random(count: int) -> Iterator[Subject]:
    """Random scenes, the first so many of an endless row."""
    for number in range(count):
        yield Subject(RANDOM, f"random {number}", random_case(number, accuracy=0.1))


def random_case(number: int, **run: Any) -> Case:
    """A chain of 2 to 80 beads of 1 to 20 mm and 0.1 to 210 GPa.

    The striker has 0.1 to 10 bead masses, is flat or round and comes at 0.01 to 10 m/s; with and without gravity,
    precompression and wall; sampled 5 to 40 times a collision. ``run`` is laid over the scene's table:
    ``accuracy=1e-4``, or ``time_step="1 us"``.
    """
    draw = np.random.default_rng(number)

    def between(low: float, high: float) -> float:
        return float(np.exp(draw.uniform(np.log(low), np.log(high))))

    count, diameter = round(between(2, 80)), between(1e-3, 20e-3)
    modulus, speed = between(1e8, 210e9), between(0.01, 10)
    flat, heavy, pressed, walled = (draw.random() < share for share in (0.3, 0.5, 0.4, 0.9))
    bead_kg = DENSITY * np.pi / 6 * diameter**3
    striker_kg = bead_kg * between(0.1, 10)
    stiffness = modulus * np.sqrt(diameter) / 3
    collision_s = (bead_kg**2 / (stiffness**2 * speed)) ** 0.2
    striker = {"shape": "flat" if flat else "sphere", "material": "m", "mass": f"{striker_kg:.6g} kg"}
    striker["speed"] = f"{speed:.6g} m/s"
    if not flat:
        striker["diameter"] = f"{diameter * (striker_kg / bead_kg) ** (1 / 3):.6g} m"
    interval, duration = collision_s / draw.uniform(5, 40), collision_s * (2 * count + 10) * draw.uniform(0.5, 1.2)
    material = {"youngs_modulus": f"{modulus:.6g} Pa", "poisson_ratio": 0.3, "density": f"{DENSITY} kg/m^3"}
    data: dict[str, Any] = {
        "chain": {"count": count, "material": "m", "diameter": f"{diameter:.6g} m"},
        "striker": striker,
        "materials": {"m": material},
        "run": {"duration": f"{duration:.6g} s", "sample_interval": f"{interval:.6g} s"} | run,
    }
    if heavy:
        data["gravity"] = "9.81 m/s^2"
    if pressed:
        data["chain"]["precompression"] = f"{hertz_force(between(1e-4, 1) * stiffness, collision_s * speed):.6g} N"
    if walled:
        data["wall"] = {"material": str(draw.choice(["brass", "rigid", "m"]))}
    scene = make_scene(data, read_toml(paths.MATERIALS), f"random-{number}", f"random scene {number}")
    return plan_case(build_case(scene))
