"""Measured limits of the time step: chains, and a scan of steps until the energy blows up.

The chains are those of the paper, sweeps of one parameter, and random ones by number. Stable steps lie between
unstable ones, so the scan tries each step, 1 % larger than the one before. It uses the in-repo Verlet, which takes
milliseconds; the codes confirm the limit.
"""

from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import inf, nan
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.terminal import counted, following
from drivers.chain.case import Case, build_case
from drivers.chain.chain import hertz_force
from drivers.chain.schemes import exact_of, verlet_of
from drivers.chain.trace import Trace, residual
from drivers.engines import VERLET, installed_codes
from drivers.limits import resolved_trial, step_limit
from drivers.run.compute import compute
from drivers.run.execute import execute
from drivers.scene.read_scene import make_scene
from postproc.read.motion import case_of
from validation.accuracy.plan import plan_case, usual_steps

PAPER = ("fig4", "fig5", "fig6b", "fig6d", "table1")
SHIPPED, RANDOM, BOUNCING = "shipped scenes", "random scenes", "impacts"
BASE = "fig4"
# by axis label: key of the scene, unit, values
SWEEPS = {
    "striker speed, m/s": ("striker.speed", "m/s", np.geomspace(1e-6, 50, 12)),
    "modulus of beads, Pa": ("materials.ptfe.youngs_modulus", "Pa", np.geomspace(1e6, 1e12, 9)),
    "striker mass / bead mass": ("striker.mass", "kg", 0.1226e-3 * np.geomspace(1e-3, 1e3, 9)),
    "modulus of the wall, Pa": ("materials.brass.youngs_modulus", "Pa", np.geomspace(1e6, 1e13, 8)),
}
BEAD_KG = 0.1226e-3
DENSITY = 2200.0  # kg/m^3, of beads of random scenes
TRAVERSE = 45.0  # duration of a sweep's scene in 2 / omega: the wave reaches the wall and returns
UNSTABLE_GAIN = 1.0  # energy gained / largest kinetic energy
WRONG, EXACT = 0.1, 1e-4  # largest error of the force / largest change, and that of the exact motion
FINENESS = 0.01  # relative step of the scan
LOWEST, HIGHEST = 0.15, 2.5  # scanned range, in limits of `beads plan`
CODE_LOWEST = 0.9  # start of the scan of a code that does not blow up where Verlet does
SHARES = np.exp(np.arange(np.log(LOWEST), np.log(HIGHEST), np.log1p(FINENESS)))
WRONG_SHARES = np.geomspace(0.01, 1.0, 95).tolist()  # of the predicted limit
CRITERION_KEYS = ("rayleigh_s", "hertz_s", "p_wave_s")
JUDGED_GROUPS = (SHIPPED, RANDOM)  # their predicted limits have to be close to the measured ones


@dataclass(frozen=True)
class MeasuredChain:
    """A chain to measure.

    Attributes:
        value: value of the parameter that a sweep varies.
    """

    group: str
    name: str
    case: Case
    value: float = nan

    def gain(self, trace: Trace) -> float:
        """Largest energy gain divided by the largest kinetic energy; inf if values are not finite."""
        change = np.nan_to_num(trace.total_energy_J - trace.total_energy_J[0], nan=np.inf)
        return float(change.max() / resolved_trial(self.case).extremes.kinetic_J)


def shipped() -> Iterator[MeasuredChain]:
    """The paper's scenes and two more."""
    for name in (*PAPER, "low-amplitude", "steel-chain"):
        yield MeasuredChain(SHIPPED, name, case_of(name))


def sweeps() -> Iterator[MeasuredChain]:
    """Sweeps of one parameter each, over decades."""
    for group, (key, unit, values) in SWEEPS.items():
        for value in values:
            setting = f"{key}={value:.6g} {unit}"
            rough = case_of(BASE, setting)
            duration = TRAVERSE * resolved_trial(rough).two_over_omega_s
            interval = duration / 800
            timing = (f"run.duration={duration:.6g} s", f"run.sample_interval={interval:.6g} s")
            case = case_of(BASE, setting, *timing, f"run.time_step={interval:.6g} s")
            yield MeasuredChain(group, f"{BASE} {setting}", case, value / BEAD_KG if unit == "kg" else float(value))


def bouncing() -> Iterator[MeasuredChain]:
    """A bead that bounces on the wall: errors of impacts add up."""
    for duration_ms in (5, 50, 500):
        settings = ("chain.count=0", "chain.sensors=[]", "gravity=981 m/s^2", "striker.speed=0.5 m/s")
        case = case_of(BASE, *settings, f"run.duration={duration_ms} ms", "run.time_step=1 us")
        impacts = float(np.count_nonzero(np.diff(verlet_of(case).force_N[:, 0] > 0)) // 2)
        yield MeasuredChain(BOUNCING, f"a bead that bounces {impacts:.0f} times", case, impacts)


def at_random(count: int) -> Iterator[MeasuredChain]:
    """The first random scenes, by number."""
    for number in range(count):
        yield MeasuredChain(RANDOM, f"random {number}", random_case(number, accuracy=0.1))


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


def measure_limits(subjects: Sequence[MeasuredChain], names: Sequence[str] | None = None) -> pd.DataFrame:
    """Limits of all subjects by Verlet and by codes, all installed ones by default; the codes run in parallel.

    Verlet is scanned. A code runs at the step where Verlet blows up and at the step before; it is scanned itself only
    if it behaves differently there.

    Returns:
        A row for each subject and method. ``group`` is the group of scenes, ``value`` the parameter of a sweep;
        ``predicted_s`` the predicted limit, a lower bound; ``measured_s`` the smallest scanned step at which the energy
        blows up, NaN if none does, ``ratio`` the measured limit divided by the predicted one; ``wrong_s`` the
        step at which a force of Verlet errs by a tenth of the largest change, NaN for random scenes;
        ``rayleigh_s``, ``hertz_s``, ``p_wave_s`` the steps of the usual criteria (``accuracy.plan.usual_steps``);
        ``steps`` the number of steps of the run at the limit.
    """
    names = installed_codes() if names is None else names
    predicted_s = [step_limit(subject.case)[0] for subject in subjects]
    pairs = following(zip(subjects, predicted_s, strict=True), "limits by verlet", len(subjects), "scene")
    by_verlet = [_row(chain, bound_s, VERLET, _scan(chain, VERLET, bound_s)) for chain, bound_s in pairs]
    with counted("limits by codes", len(subjects) * len(names), "scene") as count:
        by_code = dict(execute(lambda name: _by_code(name, subjects, by_verlet, count), names))
    return pd.DataFrame([*by_verlet, *(row for name in names for row in by_code[name])])


def _by_code(
    name: str, subjects: Sequence[MeasuredChain], by_verlet: Sequence[dict[str, Any]], count: Callable[[], None]
) -> list[dict[str, Any]]:
    rows = []
    for subject, verlet in zip(subjects, by_verlet, strict=True):
        measured_s, predicted_s = verlet["measured_s"], verlet["predicted_s"]
        gains = [_gain_on(name, subject, step_s) for step_s in (measured_s, measured_s / (1 + FINENESS)) if step_s > 0]
        if not gains or not gains[0] > UNSTABLE_GAIN >= gains[1]:  # not where Verlet blows up
            measured_s = _scan(subject, name, predicted_s, lowest=CODE_LOWEST)
        rows.append(verlet | {"method": name, "measured_s": measured_s, "ratio": measured_s / predicted_s})
        count()
    return rows


def _row(subject: MeasuredChain, predicted_s: float, method: str, measured_s: float) -> dict[str, Any]:
    case = subject.case
    return {
        "group": subject.group,
        "scene": subject.name,
        "value": subject.value,
        "method": method,
        "bodies": case.chain.bodies,
        "predicted_s": predicted_s,
        "measured_s": measured_s,
        "wrong_s": nan if subject.group == RANDOM else wrong_step_s(case, predicted_s),
        "ratio": measured_s / predicted_s,
        **dict(zip(CRITERION_KEYS, usual_steps(case).values(), strict=True)),
        "steps": float(case.sample_times_s[-1]) / measured_s,
    }


def wrong_step_s(case: Case, predicted_s: float) -> float:
    """Step at which a force of Verlet errs by a tenth of the largest change, by bisection; NaN if it never does."""

    def is_wrong(share: float) -> bool:
        sampled = case.sampled_at_every(share * predicted_s)
        return bool(residual(verlet_of(sampled), exact_of(sampled, EXACT)).max() > WRONG)

    place = bisect_left(WRONG_SHARES, True, key=is_wrong)
    return predicted_s * WRONG_SHARES[place] if place < len(WRONG_SHARES) else nan


def _gain_on(method: str, subject: MeasuredChain, step_s: float) -> float:
    """Energy gain at a step, also of a run that the guard fails; inf if a code lost a body before."""
    case = subject.case.sampled_at_every(step_s)
    if method == VERLET:
        return subject.gain(verlet_of(case))
    ended = compute(case, method)
    trace = ended.fault.partial if ended.fault else ended.trace
    return subject.gain(trace) if trace is not None and len(trace.time_s) == case.scene.samples else inf


def _scan(subject: MeasuredChain, method: str, predicted_s: float, lowest: float = LOWEST) -> float:
    """Smallest scanned step at which the energy blows up; NaN if none does."""
    for step_s in predicted_s * SHARES[lowest <= SHARES]:
        with np.errstate(all="ignore"):
            if _gain_on(method, subject, step_s) > UNSTABLE_GAIN:
                return float(step_s)
    return nan
