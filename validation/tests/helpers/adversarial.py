"""Random scenes that are hard for a prediction of the stability limit, by kind and number."""

from typing import Any

import numpy as np

from drivers.chain.case import Case, build_case
from drivers.chain.chain import hertz_force
from drivers.scene.read_scene import make_scene

KINDS = ("light bead", "light striker", "bounces", "gaps", "head on")


def adversarial_case(kind: str, number: int, *, damped: bool = False) -> Case:
    """Random chain of 0 to 12 beads: light beads between heavy ones, light strikers, bounces, gaps, beads head on.

    Durations are up to 40 collisions and a traverse, or several flights of a bounce. Damping ratios are 0.01 to 3.
    """
    draw = np.random.default_rng([number, KINDS.index(kind), damped])

    def between(low: float, high: float) -> float:
        return float(np.exp(draw.uniform(np.log(low), np.log(high))))

    count = int(draw.integers(0, 4) if kind == "bounces" else draw.integers(2, 13))
    diameter, modulus, speed = between(1e-3, 10e-3), between(1e8, 200e9), between(1e-3, 5)
    bead_kg = 2200 * np.pi / 6 * diameter**3
    stiffness = modulus * np.sqrt(diameter) / 3
    striker_kg = bead_kg * (between(1e-4, 0.1) if kind == "light striker" else between(0.1, 10))
    collision_s = (bead_kg**2 / (stiffness**2 * speed)) ** 0.2
    dent_m = collision_s * speed
    beads: dict[int, dict[str, Any]] = {}
    if kind == "light bead":
        for place in draw.choice(np.arange(1, count + 1), size=min(count, int(draw.integers(1, 4))), replace=False):
            beads[int(place)] = {"mass": f"{bead_kg * between(1e-4, 0.1):.6g} kg"}
            if draw.random() < 0.6:
                beads[int(place)]["gap_below"] = f"{dent_m * between(1e-3, 100):.6g} m"
    if kind in ("gaps", "head on"):
        for place in range(1, count + 1):
            if draw.random() < 0.5:
                beads[place] = {"gap_below": f"{dent_m * between(1e-3, 10):.6g} m"}
            if kind == "head on":
                beads.setdefault(place, {})["velocity"] = f"{speed * draw.uniform(-1, 1):.6g} m/s"
    duration = collision_s * (2 * count + 10) * between(0.3, 4)
    data: dict[str, Any] = {
        "chain": {
            "count": count, "material": "m", "diameter": f"{diameter:.6g} m",
            "bead": [{"from_wall": place, **bead} for place, bead in sorted(beads.items())],
        },
        "striker": {
            "material": "m", "mass": f"{striker_kg:.6g} kg", "speed": f"{speed:.6g} m/s",
            "diameter": f"{diameter * (striker_kg / bead_kg) ** (1 / 3):.6g} m",
        },
        "materials": {"m": {"youngs_modulus": f"{modulus:.6g} Pa", "poisson_ratio": 0.3, "density": "2200 kg/m^3"}},
    }  # fmt: skip
    if kind != "head on":
        data["wall"] = {"material": "rigid"}
    if kind == "bounces":  # flights as long as a few to hundreds of collisions
        flight_s = collision_s * between(5, 100)
        data["gravity"], duration = f"{2 * speed / flight_s:.6g} m/s^2", flight_s * between(2, 40)
    elif draw.random() < 0.5:
        data["gravity"] = "9.81 m/s^2"
    if kind == "light striker" and draw.random() < 0.4:
        data["chain"]["precompression"] = f"{hertz_force(between(1e-4, 1) * stiffness, dent_m):.6g} N"
    if damped:
        data["contact"] = {"damping_ratio": between(0.01, 3)}
    interval = f"{collision_s / 100:.6g} s"
    data["run"] = {"duration": f"{duration:.6g} s", "sample_interval": interval, "time_step": interval}
    return build_case(make_scene(data, f"{kind}-{number}", f"{kind} {number}"))
