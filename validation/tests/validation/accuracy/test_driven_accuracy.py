"""The promise of ``run.accuracy`` on random driven scenes, and the stability bound with a drive."""

from pathlib import Path

import numpy as np
import pytest

from drivers.chain.schemes import verlet_of
from drivers.engines import codes
from drivers.limits.energy_bounds import at_most, share_at_most
from drivers.limits.refusal import inability
from drivers.limits.stable_step import predicted_limit, reached
from drivers.run.guard import checked
from postproc.read.residual import residual
from validation.accuracy.exact_motion import exact_motion_of
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import case_of

ACCURACIES = (1e-2, 1e-4)
QUICK, ALL = range(3), range(3, 18)


def random_settings(number: int) -> list[str]:
    """Settings of ``driven-steel``: wave form, amplitude, body, precompression, damping at random."""
    draw = np.random.default_rng([36, number])
    beads, form = int(draw.integers(2, 24)), ("sine", "half-sine", "step", "ramp", "chirp")[number % 5]
    settings = [f"chain.count={beads}", f"drive.form={form}", "drive.window=", "drive.cycles=", "drive.frequency="]
    settings += [
        "run.duration=0.4 ms",
        "run.time_step=",
        "chain.sensors=[]",
        f"drive.start={draw.uniform(0, 50):.4g} us",
    ]
    if form in ("sine", "chirp"):
        settings.append(f"drive.frequency={draw.uniform(1, 10):.3g} kHz")
    if form in ("half-sine", "ramp", "chirp"):
        settings.append(f"drive.duration={draw.uniform(30, 200):.3g} us")
    if form == "chirp":
        settings += [f"drive.end_frequency={draw.uniform(6, 20):.3g} kHz", "drive.window=hann"]
    settings.append(f"chain.precompression={10 ** draw.uniform(-1, 2) * (draw.random() < 0.7):.3g} N")
    settings.append(f"drive.from_wall={draw.integers(1, beads + 1)}")
    if draw.random() < 0.3:
        settings.append(f"contact.damping_ratio={draw.uniform(0.01, 0.2):.3g}")
    if form == "step" or draw.random() < 0.5:
        return [*settings, f"drive.force={-(10 ** draw.uniform(-1, 2)):.3g} N"]
    return [*settings, "drive.force=", f"drive.displacement={-(10 ** draw.uniform(1.5, 3.5)):.3g} nm"]


def check(number: int) -> None:
    """The accuracy is kept, the guard agrees, and the bound of the stability limit is one."""
    for accuracy in ACCURACIES:
        case = case_of("driven-steel", *random_settings(number), f"run.accuracy={accuracy}")
        truth = exact_motion_of(case.full or case, finer=False)
        trace = verlet_of(case)
        assert residual(trace, truth.trace).max() <= accuracy
        checked(case, trace)
    chain, duration_s = case.chain, 4e-4
    limit_s = predicted_limit(chain, duration_s)
    assert share_at_most(chain, duration_s, limit_s)[0] >= 0.99
    assert (reached(chain, duration_s).overlap_m <= at_most(chain, duration_s).overlap_m).all()


@pytest.mark.parametrize("number", QUICK)
def test_the_accuracy_is_kept(number: int) -> None:
    check(number)


@pytest.mark.accuracy
@pytest.mark.parametrize("number", ALL)
def test_the_accuracy_is_kept_on_many_scenes(number: int, shared_runs: Path) -> None:
    check(number)
    case = case_of("driven-steel", *random_settings(number), "run.accuracy=1e-3")
    truth = exact_motion_of(case.full or case, finer=False).trace
    able = [engine for engine in codes() if inability(case, engine) is None]
    assert able
    for engine in able:
        assert residual(finished(case, engine, shared_runs).trace, truth).max() <= 1e-3, engine
