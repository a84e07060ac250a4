"""The in-repo integrators of a Hertz chain: arrays in, arrays out.

This folder imports no other package of the project. Equations of motion, u positive upwards:
``m_j u_j'' = F_j - F_{j+1} + load_j`` with ``F_j = k_j overlap_j^(3/2)`` (the paper's Eq. 7) for elastic contacts and
``F_j = max(0, k_j overlap_j^(3/2) + C_j overlap_j^p d overlap_j/dt)`` for dissipative contacts.
"""

import time
from typing import Any

import numpy as np

from validation.reference.hertz_chain import (
    NEVER,
    TUBE_KEYS,
    VISCOELASTIC_POWER,
    Array,
    Drive,
    Flag,
    HertzChain,
    Motion,
    TubeChain,
    TubeMotion,
)

_loaded: set[tuple[object, ...]] = set()  # kinds of decks whose integrators are loaded
ARRAY_KEYS = ("mass_kg", "stiffness_N_m-3/2", "overlap_m", "velocity_m_s", "load_N")
DAMPING_KEYS = ("gamma_N_(s/m)^alpha", "damping_N_s_m-5/4", "damping_N_s_m-(1+p)")


def timed(values: dict[str, Any], stop: Flag = NEVER) -> tuple[Motion | TubeMotion, float]:
    """Motion of a deck and the seconds of its integration, without those of loading or compiling the integrator.

    Args:
        values: contents of the deck ``chain.json``.
        stop: flag that ends the integration.

    Raises:
        ArithmeticError: the adaptive integrator fails, or was ended.
    """
    integrate = _tube if "place_m" in values else _straight
    kind = (values["method"], *(key in values for key in ("place_m", "alpha", "drive")))
    if kind not in _loaded:
        integrate(values | {"steps_per_sample": 1, "samples": 2}, stop)
        _loaded.add(kind)
    began = time.perf_counter()
    return integrate(values, stop), time.perf_counter() - began


def columns_of(motion: Motion | TubeMotion) -> list[Array]:
    """Columns of the output, each of shape (samples, bodies): contact force, then the motion.

    A straight chain has displacement and velocity; a three-dimensional one bore force, position, velocity and spin,
    each by x, y and height.
    """
    if isinstance(motion, Motion):
        return [motion.force_N, motion.displacement_m, motion.velocity_m_s]
    triples = (motion.bore_N, motion.place_m, motion.velocity_m_s, motion.spin_rad_s)
    return [motion.force_N, *(column for triple in triples for column in np.moveaxis(triple, 2, 0))]


def _straight(values: dict[str, Any], stop: Flag) -> Motion:
    mass, stiffness, overlap, velocity, load = (values[key] for key in ARRAY_KEYS)
    damping: Any = next((values[key] for key in DAMPING_KEYS if key in values), [])
    powers = values.get("alpha", 0.0), values.get("overlap_power", VISCOELASTIC_POWER)
    drive = None
    if "drive" in values:
        prescribed = values["drive"] == "displacement of the body"
        drive = Drive(values["driven_body"] - 1, prescribed, values["drive_segments"])
    chain = HertzChain(mass, stiffness, overlap, velocity, load, damping, *powers, drive)
    if values["method"] == "verlet":
        from validation.reference.velocity_verlet import integrate_verlet

        return integrate_verlet(chain, values["time_step_s"], values["steps_per_sample"], values["samples"], stop)
    from validation.reference.adaptive import integrate_adaptive

    times = np.arange(values["samples"], dtype=float) * values["sample_interval_s"]
    return integrate_adaptive(chain, times, values["tolerance"], stop)


def _tube(values: dict[str, Any], stop: Flag) -> TubeMotion:
    from validation.reference.tube import TOTAL, integrate_tube

    chain = TubeChain(
        mass_kg=values["mass_kg"],
        radius_m=np.array([np.inf if diameter is None else diameter / 2 for diameter in values["diameter_m"]]),
        stiffness=values["stiffness_N_m-3/2"],
        damping=values.get("damping_N_s_m-5/4", np.zeros(len(values["mass_kg"]))),
        load_N=values["load_N"],
        **{field: values[key] for field, key in TUBE_KEYS.items()},
    )
    return integrate_tube(chain, values["time_step_s"], values["steps_per_sample"], values["samples"], TOTAL, stop)
