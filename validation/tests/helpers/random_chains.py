"""Random chains by number, for tests of what has to hold for any chain."""

from typing import Any

import numpy as np

from drivers.chain.case import Case, build_case
from drivers.chain.chain import hertz_force
from drivers.scene.read_scene import make_scene
from validation.accuracy.plan import plan_case

DENSITY = 2200.0  # kg/m^3


def random_case(number: int, **run: Any) -> Case:
    """Random chain of 2 to 80 beads of 1 to 20 mm and 0.1 to 210 GPa.

    The striker has 0.1 to 10 bead masses, is flat or round and has 0.01 to 10 m/s. Gravity, precompression and wall are
    random; a collision has 5 to 40 samples. ``run`` sets keys of the scene's ``[run]``, such as ``accuracy=1e-4``.
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
    scene = make_scene(data, f"random-{number}", f"random scene {number}")
    return plan_case(build_case(scene))
