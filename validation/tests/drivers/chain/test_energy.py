"""Energy and momentum: exact to rounding however large the static load; their balances with all that is integrated."""

from collections.abc import Iterator
from decimal import Decimal, localcontext

import numpy as np
import pytest
from scipy.integrate import cumulative_simpson

from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain
from drivers.chain.schemes import exact_motion, exact_of, trace_of, verlet_in_heights, verlet_motion, verlet_of
from drivers.chain.trace import Trace, potential_energy_change
from drivers.engines import codes
from drivers.run.compute import compute
from postproc.read.observables import energy_error_J
from validation.reference.adaptive import MIN_TOLERANCE
from validation.tests.drivers.engines.test_contact_laws import SETTINGS
from validation.tests.helpers.adversarial import KINDS, adversarial_case
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import case_of

PRESSED = ("chain.precompression=10 N", "chain.sensors=[]", "run.time_step=1 us")
DIGITS = 40
PUSHED = ("driven-steel", "drive.force=", "drive.displacement=-20 um", "run.duration=0.5 ms")
SCENES = {  # contacts open in all of them
    "struck": ("fig4",),
    "force": ("driven-steel", "drive.force=40 N", "drive.window=", "run.duration=0.5 ms"),
    "displacement": PUSHED,
    "no wall": (*PUSHED, "wall=", "gravity=9.81 m/s^2"),
}
ORDERS = {  # of the sums of velocity Verlet
    "elastic": (2, (), ("passed_J", "drive_work_J", "drive_impulse_N_s")),
    "damped": (1, SETTINGS["hunt-crossley"], ("passed_J", "dissipated_J")),
}


def exact_change(chain: Chain, displacement_m: Array) -> float:
    """Change of the potential energy of one sample in 40 digits, from its definition."""
    with localcontext() as context:
        context.prec = DIGITS
        total, below = Decimal(0), Decimal(0)
        columns = (chain.overlap_m, chain.stiffness, chain.load_N, displacement_m)
        for start, stiffness, load, moved in zip(*([Decimal(float(x)) for x in each] for each in columns), strict=True):
            pressed = [max(overlap, Decimal(0)) for overlap in (start + below - moved, start)]
            energies = [overlap**2 * overlap.sqrt() for overlap in pressed]
            total += Decimal(2) / 5 * stiffness * (energies[0] - energies[1]) - load * moved
            below = moved
        return float(total)


@pytest.mark.parametrize("kind", KINDS)
def test_the_potential_energy_is_its_definition(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """In one part, and in parts of two samples."""
    for number in range(5):
        chain = adversarial_case(kind, number).chain
        monkeypatch.setattr("drivers.chain.trace.CACHED_VALUES", 100_000 if number else 2 * chain.bodies)
        draw = np.random.default_rng(number)
        size_m = np.abs(chain.overlap_m).max() * 10 ** draw.uniform(-9, 1)
        moved = size_m * draw.standard_normal((5, chain.bodies))
        change = -np.diff(moved, axis=1, prepend=0.0)
        terms = np.abs(chain.load_N * moved).sum(axis=1) + (chain.stiffness * np.abs(change) ** 2.5).sum(axis=1)
        exact = [exact_change(chain, row) for row in moved]
        assert np.abs(potential_energy_change(chain, moved) - exact).max() <= 1e-13 * terms.max()


def drift(trace: Trace) -> float:
    return float(np.abs(trace.total_energy_J - trace.total_energy_J[0]).max() / trace.kinetic_energy_J.max())


@pytest.mark.parametrize("speed", ["1e-7 m/s", "1e-4 m/s", "1 m/s"])
@pytest.mark.parametrize("settings", [("gravity=",), ("chain.count=3", "chain.precompression=1 mN")])
def test_no_static_load_hides_the_energy_of_a_weak_wave(settings: tuple[str, ...], speed: str) -> None:
    weak = (*PRESSED, *settings, f"striker.speed={speed}")
    case, damped = case_of("fig4", *weak), case_of("fig4", *weak, "contact.damping_ratio=0.01")
    assert drift(exact_of(case)) < 1e-6
    coarse = drift(verlet_of(case))
    assert coarse < 1e-2
    assert drift(verlet_of(case, finer=4)) == pytest.approx(coarse / 16, rel=0.1, abs=1e-8)  # truncation, no rounding
    assert drift(verlet_in_heights(case)) == pytest.approx(coarse, rel=0.01, abs=2e-4)
    trace = exact_of(damped)
    gained_J = energy_error_J(trace.total_energy_J, damped=True, slips=False).max()
    assert gained_J < 1e-6 * trace.kinetic_energy_J.max()
    assert trace.total_energy_J[0] - trace.total_energy_J[-1] > 1e-3 * trace.kinetic_energy_J.max()


def balanced_cases() -> Iterator[Case]:
    for kind in KINDS:
        yield from (adversarial_case(kind, number, damped=damped) for number in range(2) for damped in (False, True))
    for scene in SCENES.values():
        yield from (case_of(*scene, *law) for law in ((), *SETTINGS.values()))


def test_energy_and_momentum_balance_with_all_that_is_integrated() -> None:
    """The impulse of a wall is not integrated, but summed over samples."""
    for case in balanced_cases():
        chain, times = case.chain, case.sample_times_s
        motion = exact_motion(case, MIN_TOLERANCE, times, energies=True)
        trace = trace_of(case, times, motion)
        assert motion.dissipated_J is not None
        lost_J, largest_J = motion.dissipated_J.sum(axis=1), trace.kinetic_energy_J.max()
        assert np.ptp(trace.total_energy_J + lost_J) < 1e-12 * largest_J, case.summary
        assert (lost_J[-1] > 1e-2 * largest_J) == chain.damped
        impulse = chain.load_N.sum() * times
        if motion.drive_impulse_N_s is not None:
            impulse = impulse + motion.drive_impulse_N_s
        if chain.wall is not None:
            impulse = impulse + cumulative_simpson(motion.force_N[:, 0], x=times, initial=0)
        change = trace.momentum_N_s - trace.momentum_N_s[0] - impulse
        within = 1e-13 if chain.wall is None else 2e-5
        assert np.abs(change).max() < within * np.sqrt(2 * largest_J * chain.mass_kg.sum()), case.summary


@pytest.mark.parametrize("law", ORDERS)
@pytest.mark.parametrize("scene", ["force", "displacement"])
def test_sums_of_verlet_converge_with_the_order_of_the_scheme(scene: str, law: str) -> None:
    order, settings, names = ORDERS[law]
    case = case_of(*SCENES[scene], *settings)
    exact = exact_motion(case, MIN_TOLERANCE, case.sample_times_s, energies=True)
    coarse, fine = (verlet_motion(case, finer, energies=True) for finer in (2, 4))
    for name in names:
        errors = [np.abs(getattr(motion, name) - getattr(exact, name)).max() for motion in (coarse, fine)]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.05), name


@pytest.mark.parametrize("kind", KINDS)
def test_codes_run_random_scenes_as_written(kind: str) -> None:
    for engine in codes():
        need(engine)
        assert compute(case := adversarial_case(kind, 1), engine).fault is None, case.summary
