"""The exact motion: the error that it states of itself, and true values of observables between samples."""

import numpy as np
import pytest

from drivers.chain.case import Case
from drivers.chain.schemes import exact_of, verlet_of
from drivers.chain.trace import largest_change_N
from validation.accuracy.motions import exact_motion_of, quantities
from validation.tests.helpers import high_precision
from validation.tests.helpers.adversarial import adversarial_case
from validation.tests.helpers.scenes import case_of

SAMPLES = 12  # compared with the motion in 40 digits
TRUE_FACTOR = 128  # samples of the true motion for each of the scene
LEAST_ERROR = 1e-8  # smaller errors are not of interest here
ACCURACY = 3e-4
GAPS = "chain.bead=[{from_wall=3, gap_below='20 um'}, {from_wall=5, gap_below='5 um', mass='2 mg'}]"
LOOSE = ("gravity=", "chain.sensors=[]", "chain.count=5", GAPS, "run.sample_interval=10 us", "run.duration=0.25 ms")
LAWS = (
    (),
    ("contact.damping_ratio=0.05",),
    ("contact.dissipation=power", "contact.gamma=0.8", "contact.alpha=1.7"),
)


def pressed_case(number: int) -> Case:
    """A random chain of steel balls under 1 mN to 30 N, struck at 1e-8 m/s to 0.1 m/s."""
    draw = np.random.default_rng(number)
    count, load_N, speed_m_s = int(draw.integers(1, 6)), 10 ** draw.uniform(-3, 1.5), 10 ** draw.uniform(-8, -1)
    contact_s = 3e-5 * load_N ** (-1 / 6)
    chain = ("chain.sensors=[]", f"chain.count={count}", f"chain.precompression={load_N} N")
    timing = (f"run.sample_interval={contact_s} s", f"run.time_step={contact_s} s", f"run.duration={30 * contact_s} s")
    return case_of("steel-chain", *chain, f"striker.speed={speed_m_s} m/s", *timing)


@pytest.mark.parametrize(
    ("kind", "number", "damped"),
    [
        ("light bead", 6, False),
        ("light striker", 2, True),
        ("bounces", 5, True),
        ("gaps", 10, False),
        ("pressed", 0, False),
        ("pressed", 1, False),
    ],
)
def test_the_stated_error_is_no_less_than_the_true_one(kind: str, number: int, damped: bool) -> None:
    """The true error is that against a motion in 40 digits; a static load makes the stated one no smaller."""
    case = pressed_case(number) if kind == "pressed" else adversarial_case(kind, number, damped=damped)
    chosen = np.arange(0, case.scene.samples, max(1, case.scene.samples // SAMPLES))
    motion = exact_motion_of(case, finer=False)
    right = np.array(list(high_precision.forces_at(case.chain, case.sample_times_s[chosen])))
    change_N = largest_change_N(motion.trace.force_N)
    true = float(np.abs(motion.trace.force_N[chosen] - right).max()) / change_N
    stated = float(motion.error[chosen[-1]])
    assert true <= stated <= (30 * max(true, 1e-13) if kind == "pressed" else 1e-8)


def test_errors_stated_at_looser_tolerances_are_near_the_true_ones() -> None:
    """The range stated by the docstring of ``error`` holds for a further chain with light and loose beads."""
    case = case_of("fig4", *LOOSE)
    right = np.array(list(high_precision.forces_at(case.chain, case.sample_times_s)))
    for tolerance in (1e-5, 1e-9):
        motion = exact_motion_of(case, tolerance, finer=False)
        true = np.maximum.accumulate(np.abs(motion.trace.force_N - right).max(axis=1)) / largest_change_N(right)
        moving = true > 1e-14
        assert moving.sum() > 10
        assert (motion.error[moving] > true[moving] / 12).all()
        assert (motion.error[moving] < 30 * true[moving]).all()


def train(number: int, *settings: str) -> Case:
    """A random scene of waves in a train: a heavy striker, and each law of dissipation in turn."""
    draw = np.random.default_rng(number)
    count, speed = int(draw.integers(5, 8)), 10 ** draw.uniform(-1, 0.3)
    contact_us = 4.0 * 4.76 * (0.5 / speed) ** 0.2
    step_us = contact_us / draw.uniform(15, 40)
    duration_us = int(2.5 * count * contact_us / step_us + 100) * step_us
    sensors = f"chain.sensors=[{{from_wall={count - 1}}}, {{from_wall={count - 4}}}]"
    striker = ("striker.mass=0.49 g", f"striker.speed={speed:.4g} m/s", f"gravity={draw.choice([0, 9.81])} m/s^2")
    timing = (f"run.duration={duration_us:.6g} us", f"run.sample_interval={step_us:.6g} us")
    step = f"run.time_step={step_us:.6g} us"
    return case_of("fig4", f"chain.count={count}", sensors, *striker, *LAWS[number], *timing, step, *settings)


def own_scale(name: str, values: dict[str, float]) -> float:
    """The value that an error is relative to, as the README defines it: of peaks the part above the static load."""
    if "_peak" not in name:
        return abs(values[name])
    gauge = name.partition("_peak")[0]
    return abs(values[name] - (values[f"{gauge}_peak"] - values[f"{gauge}_amplitude"]))


def errors(found: dict[str, float], true: dict[str, float]) -> dict[str, float]:
    return {name: abs(found[name] - true[name]) / own_scale(name, true) for name in found.keys() & true.keys()}


@pytest.mark.parametrize("number", range(3))
def test_sampling_errors_are_the_true_ones_and_planned_accuracies_are_kept(number: int) -> None:
    """True values are read from 128 times the samples; each accuracy is relative to its own quantity."""
    given = train(number)
    motion, true = exact_motion_of(given), quantities(given, exact_of(given, finer=TRUE_FACTOR))
    stated, right = (errors(motion.sampled, values) for values in (motion.true, true))
    seen = {name: error for name, error in right.items() if error > LEAST_ERROR}
    assert len(right) > 12
    assert {name: stated[name] for name in seen} == pytest.approx(seen, rel=0.1)
    reachable = sorted(name for name, error in right.items() if error < 0.5 * ACCURACY)
    assert len(reachable) > 8
    for name in reachable[:: len(reachable) // 3]:  # of each kind of observable
        case = train(number, "run.time_step=", f'run.accuracy={{"{name}" = {ACCURACY}}}')
        assert errors(quantities(case, verlet_of(case)), true)[name] <= 1.02 * ACCURACY, name
