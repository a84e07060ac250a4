"""Cases of small signals and of waves that meet: theories, measures, and what turns them red."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar
from scipy.special import hankel1, jv

from drivers.chain.case import Case, build_case
from drivers.chain.chain import Array
from drivers.chain.contact_law import contact_stiffness
from drivers.chain.trace import Trace
from drivers.engines import installed_codes
from drivers.run.run import run_case
from drivers.scene.read_scene import read_scene
from postproc.read.motion import trace_with_state
from validation.claims.cases import MEASURES, Independent, pose, read_independent
from validation.claims.judged import IN_REPO
from validation.claims.measures import bands, linear, weak
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import case_of

WAVES = ("small signal", "collision", "weak strike", "precompressed wave", "decorated chain", "taper")
OTHER_MEASURES = (*WAVES, "bands", "impurity", "driven")
CASES = {entry.id: entry for entry in read_independent() if entry.measure in OTHER_MEASURES}
SMALL, QUICK = "linear-limit-1mN", "linear-limit-13mN"
CUTOFF, BANDS, HEAVY, TUNED, DRIVEN = (
    "cutoff-in-spectrum", "dimer-bands", "heavy-impurity", "precompressed-ptfe", "transfer-in-band"
)  # fmt: skip
AT_CONTACT, AT_BEAD, WEAK = "head-on-at-contact", "head-on-at-bead", "weak-strike-under-gravity"


@cache
def posed(name: str) -> Case:
    """The case of an entry."""
    return pose(CASES[name])[0].case


def with_settings(name: str, *settings: str) -> Case:
    """The same with more settings."""
    entry = CASES[name]
    assert entry.scene is not None
    return build_case(read_scene(entry.scene, (*entry.set, *settings)))


@cache
def exact_trace(name: str) -> Trace:
    """Its run by the reference."""
    return IN_REPO["reference"](posed(name))


def red(entry: Independent, case: Case, trace: Trace) -> set[tuple[str, str]]:
    """The checks that a trace fails as the run of a case, by quantity and by what they are compared with."""
    measure = MEASURES[entry.measure]
    found, theory = measure.measure(case, trace), measure.theory(case)
    return {
        (check.quantity, check.against)
        for check in entry.check
        if not check.error(
            found[check.quantity], theory[check.quantity] if check.expected is None else check.expected
        ) <= check.limit
    }  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_the_in_repo_engines_pass(name: str) -> None:
    assert not red(CASES[name], posed(name), exact_trace(name))
    assert not red(CASES[name], posed(name), IN_REPO["verlet"](posed(name)))


@pytest.mark.parametrize(
    "name", [each if each == QUICK else pytest.param(each, marks=pytest.mark.long) for each in CASES]
)
@pytest.mark.parametrize("engine", installed_codes())
def test_the_codes_pass(engine: str, name: str, shared_runs: Path) -> None:
    need(engine)
    ended = run_case(posed(name), engine, shared_runs)
    assert ended.done, ended.record.reason
    assert not red(CASES[name], posed(name), trace_with_state(ended))


@pytest.mark.parametrize(
    ("name", "settings", "reds"),
    [
        (SMALL, ["materials.ptfe.youngs_modulus=1.461 GPa"], {"cutoff_frequency_Hz", "sound_speed_m_s"}),
        (SMALL, ["chain.precompression=1.201 mN"], {"cutoff_frequency_Hz", "sound_speed_m_s"}),
        (SMALL, ["chain.mass=0.1227 g"], {"cutoff_frequency_Hz", "sound_speed_m_s"}),
        (SMALL, ["chain.bead=[{ from_wall = 40, velocity = '-0.3001 um/s' }]"], {"impulse_share"}),
        (SMALL, ["chain.bead=[{ from_wall = 40, velocity = '-0.3 um/s', mass = '0.124 g' }]"], {"misfit"}),
        (AT_CONTACT, [CASES[AT_BEAD].set[1].replace("161", "160").replace("'1 m/s'", "'1.0001 m/s'")],
         {"middle_share", "asymmetry", "momentum_share"}),
        (WEAK, ["gravity=9.7 m/s^2"], {"force_20_deep_N", "arrival_450_deep_s"}),
        (WEAK, ["gravity=", "chain.precompression=0.3 N"], {"velocity_exponent", "force_exponent", "arrival_exponent"}),
        (WEAK, ["materials.ptfe.youngs_modulus=1.47 GPa"], {"force_100_deep_N", "arrival_450_deep_s"}),
        (CUTOFF, ["chain.precompression=20.02 N"], {"highest_Hz"}),
        (CUTOFF, ["chain.bead="], {"lines"}),
        (BANDS, ["materials.steel.youngs_modulus=203.2 GPa"], {"below_gap_Hz", "above_gap_Hz", "highest_Hz"}),
        (BANDS, ["wall.material=rigid"], {"below_gap_Hz", "highest_Hz"}),
        (HEAVY, [CASES[HEAVY].set[2].replace("8 g", "8.01 g")], {"transmitted_share"}),
        (TUNED, ["chain.mass=0.12261 g"], {"speed_over_exact"}),
        (DRIVEN, ["chain.precompression=20.001 N"], {"near_gain", "far_gain"}),
        (DRIVEN, ["drive.force=-0.3001 mN"], {"near_gain", "far_gain"}),
    ],
)  # fmt: skip
def test_a_run_of_another_chain_is_red(name: str, settings: list[str], reds: set[str]) -> None:
    strange = IN_REPO["reference"](with_settings(name, *settings))
    assert reds <= {quantity for quantity, against in red(CASES[name], posed(name), strange) if against == "theory"}


def test_waves_that_meet_at_a_bead_are_red_where_a_contact_is_asked_for() -> None:
    found = MEASURES["collision"].measure(posed(AT_BEAD), exact_trace(AT_BEAD))
    theory = MEASURES["collision"].theory(posed(AT_CONTACT))
    reds = {check.quantity for check in CASES[AT_CONTACT].check
            if check.error(found[check.quantity], theory[check.quantity]) > check.limit}  # fmt: skip
    assert reds == {"middle_share", "outgoing_share", "secondary_share"}


@pytest.mark.parametrize("quantity", ["velocity_exponent", "force_exponent"])
@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_another_published_exponent_is_red(quantity: str, factor: float) -> None:
    entry = CASES[WEAK]
    checks = tuple(
        check.model_copy(update={"expected": factor * check.expected})
        if check.quantity == quantity and check.expected is not None else check
        for check in entry.check
    )  # fmt: skip
    assert red(entry.model_copy(update={"check": checks}), posed(WEAK), exact_trace(WEAK)) == {(quantity, "quoted")}


def test_an_engine_with_springs_of_constant_stiffness_is_red() -> None:
    """As if a code took the contacts' stiffness from one force, at any force."""
    case = posed(WEAK)
    flat = replace(
        case.chain,
        stiffness=np.full(500, case.chain.stiffness[200]),
        overlap_m=case.chain.overlap_m[200:201].repeat(500),
    )
    velocity, force = weak.motion_by_modes(flat, case.sample_times_s, np.arange(500))
    trace = replace(exact_trace(WEAK), force_N=force + case.chain.force_N, velocity_m_s=velocity)
    assert ("velocity_exponent", "quoted") in red(CASES[WEAK], case, trace)


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        (SMALL, ["run.duration=1 ms"], "too short"),
        (SMALL, ["chain.count=20", "chain.bead=[{ from_wall = 20, velocity = '-1 um/s' }]"], "the reflection arrives"),
        (AT_CONTACT, ["run.duration=2.5 ms"], "1 waves within the run"),
        (AT_CONTACT, ["chain.count=60", "chain.bead=[{ from_wall = 1, velocity = '1 m/s' }]"], "none 40 "),
        (WEAK, ["run.duration=2 ms"], "no leading peak at this depth"),
        (CUTOFF, ["run.duration=50 us"], "fewer than two lines"),
        (TUNED, ["run.duration=0.4 ms"], "no wave within"),
        (TUNED, ["chain.sensors=[{ from_wall = 40 }]"], "fewer than two sensors"),
        (WEAK, ["run.sample_interval=80 us", "run.time_step=2 us"], "run.sample_interval is too long"),
        (WEAK, ["chain.count=300", "chain.bead=[{ from_wall = 300, velocity = '-5 um/s' }]"], "too few for a depth"),
    ],
)  # fmt: skip
def test_runs_that_show_nothing_say_so(name: str, settings: list[str], words: str) -> None:
    case = with_settings(name, *settings)
    with pytest.raises(ValueError, match=words):
        MEASURES[CASES[name].measure].measure(case, IN_REPO["reference"](case))


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        (TUNED, ["chain.precompression="], "without precompression"),
        (TUNED, ["chain.bead=[{ from_wall = 9, mass = '1 g' }]"], "of unequal beads"),
        (HEAVY, ["chain.bead=[{ from_wall = 70, velocity = '-1 um/s' }]"], "not one bead of another mass"),
        (DRIVEN, ["run.duration=4 ms"], "too short to separate"),
        (DRIVEN, ["drive.cycles=9"], "no sine force that lasts"),
        (DRIVEN, ["chain.precompression="], "a contact without static load"),
        (BANDS, ["chain.precompression="], "a contact without static load"),
    ],
)
def test_a_theory_of_other_chains_is_refused(name: str, settings: list[str], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        MEASURES[CASES[name].measure].theory(with_settings(name, *settings))


def test_lines_are_found_between_the_samples_of_a_spectrum() -> None:
    time, true = np.linspace(0.0, 0.04, 4000, endpoint=False), np.array([1234.5, 1467.8, 9876.54])
    phases = 2 * np.pi * np.outer(time, true) + np.array([0.3, 1.0, 2.0])
    signal = np.sin(phases) @ np.array([[1.0], [0.02], [0.01]])
    assert bands.lines_Hz(time, signal) == pytest.approx(true, rel=5e-6)


@pytest.mark.parametrize(("mass", "share"), [("12 g", 1 / 3), ("8 g", 1 / 2), ("1 g", 4 / 7)])
def test_what_passes_an_impurity_in_the_end(mass: str, share: float) -> None:
    beads = f"chain.bead=[{{ from_wall = 500, mass = '{mass}' }}, {{ from_wall = 503, velocity = '-10 um/s' }}]"
    case = with_settings(HEAVY, "chain.count=1000", "chain.origin=-5 m", beads, "run.duration=15 ms")
    assert MEASURES["impurity"].theory(case)["transmitted_share"] == pytest.approx(share, rel=1e-5)


def test_a_run_without_state_says_so() -> None:
    with pytest.raises(ValueError, match="no state recorded"):
        weak.measure(posed(WEAK), replace(exact_trace(WEAK), velocity_m_s=None))


@pytest.mark.parametrize("order", [2, 10, 60])
def test_the_first_maximum_of_the_response(order: int) -> None:
    tau = linear.first_maximum(order)
    found = minimize_scalar(lambda x: -jv(order, x) / x, bounds=(0.7 * tau, 1.3 * tau), method="bounded",
                            options={"xatol": 1e-10})  # fmt: skip
    assert tau == pytest.approx(found.x, rel=1e-7)
    assert not (np.diff(linear.response(order, np.linspace(0.01, tau, 200))) < -1e-300).any()


def linear_chain(spring: Array, mass: Array, velocity: Array, times: Array) -> tuple[Array, Array]:
    """Velocities and forces of springs and masses by scipy's integrator."""
    n = len(mass)

    def forces(place: Array) -> Array:
        return np.asarray(spring * -np.diff(place, prepend=0.0))

    def rates(_: float, state: Array) -> Array:
        force = forces(state[:n])
        return np.concatenate([state[n:], (force - np.append(force[1:], 0.0)) / mass])

    start = np.concatenate([np.zeros(n), velocity])
    solved = solve_ivp(rates, (0.0, times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-14)
    return solved.y[n:].T, np.array([forces(place) for place in solved.y[:n].T])


def test_small_motions_by_modes_are_those_of_springs_and_masses() -> None:
    case = case_of("deep-chain", "chain.count=12", "chain.bead=[{ from_wall = 12, velocity = '-5 um/s' }]")
    chain, times = case.chain, case.sample_times_s[:300]
    velocity, force = weak.motion_by_modes(chain, times, np.arange(12))
    unit, speed = chain.mass_kg[0], 5e-6
    spring = contact_stiffness(chain.stiffness, chain.overlap_m)
    rate = np.sqrt(spring[0] / unit)
    theirs = linear_chain(spring / spring[0], chain.mass_kg / unit, chain.velocity_m_s / speed, rate * times)
    assert velocity / speed == pytest.approx(theirs[0], abs=1e-9)
    assert force / (speed * np.sqrt(spring[0] * unit)) == pytest.approx(theirs[1], abs=1e-9)


@pytest.mark.parametrize("place", [1, 5, 30])
def test_the_response_of_a_uniform_chain_is_that_of_its_modes(place: int) -> None:
    case = posed(SMALL)
    column, times = case.chain.beads - place, case.sample_times_s[case.sample_times_s < 2.5e-3]
    _, force = weak.motion_by_modes(case.chain, times, np.array([column]))
    rate = 2 * np.pi * linear.theory(case)["cutoff_frequency_Hz"]
    spring, mass = contact_stiffness(case.chain.stiffness, case.chain.overlap_m)[-1], case.chain.mass_kg[-1]
    closed = 4 * place * 3e-7 * np.sqrt(spring * mass) * linear.response(2 * place, rate * times)
    assert force[:, 0] == pytest.approx(closed, abs=1e-10 * np.abs(closed).max())


def test_what_is_fitted_does_not_depend_on_where_the_fit_starts() -> None:
    time, rate = np.arange(0.0, 100.0, 0.05), 1.0173
    record = 3.0 * linear.response(2, rate * time)
    fitted, amplitude, misfit = linear.fit(time, record, 2, linear.LAST_TAU)
    assert fitted == pytest.approx(rate, rel=1e-12)
    assert amplitude == pytest.approx(record.max(), rel=1e-3)
    assert misfit < 1e-12


@pytest.mark.parametrize(("beads", "published"), [(160, 2.238), (161, 1.750)])
def test_the_middle_takes_what_a_wall_would(beads: int, published: float) -> None:
    """A wave's energy goes with its force to the power 5/3: what the outgoing one lacks the secondary one has."""
    name = AT_CONTACT if beads == 160 else AT_BEAD
    shares = MEASURES["collision"].theory(posed(name))
    assert shares["middle_share"] == pytest.approx(published, abs=5e-4)
    energy = shares["outgoing_share"] ** (5 / 3) + shares["secondary_share"] ** (5 / 3)
    assert energy == pytest.approx(1, abs=5e-4)  # further waves carry the rest


def test_the_secondary_wave_does_not_depend_on_the_length_of_the_chain() -> None:
    longer = "chain.bead=[{ from_wall = 1, velocity = '1 m/s' }, { from_wall = 201, velocity = '-1 m/s' }]"
    case = with_settings(AT_BEAD, "chain.count=201", longer, "run.duration=5.6 ms")
    values = MEASURES["collision"].measure(case, IN_REPO["reference"](case))
    assert values["secondary_share"] == pytest.approx(MEASURES["collision"].theory(case)["secondary_share"], rel=1e-6)


LOCAL = {45: -0.230, 130: -0.240, 500: -0.250, 1100: -0.254}


@cache
def velocities_of_a_longer_chain() -> dict[int, float]:
    """The velocity's local exponents by the modes of 1300 beads."""
    bead = "chain.bead=[{ from_wall = 1300, velocity = '-5 um/s' }]"
    case = case_of("deep-chain", "chain.count=1300", bead, "run.duration=42 ms", "run.sample_interval=14 us",
                   "run.time_step=1 us")  # fmt: skip
    depths = np.array([[round(0.9 * depth), round(1.1 * depth)] for depth in LOCAL])
    velocity, _ = weak.motion_by_modes(case.chain, case.sample_times_s, 1300 - depths.ravel())
    peaks = [weak.leading_peak(case.sample_times_s, -column).value for column in velocity.T]
    slopes = np.diff(np.log(peaks))[::2] / np.diff(np.log(depths))[:, 0]
    return dict(zip(LOCAL, slopes.tolist(), strict=True))


@pytest.mark.parametrize("depth", LOCAL)
def test_the_powers_of_depth_are_those_of_middle_depths(depth: int) -> None:
    assert velocities_of_a_longer_chain()[depth] == pytest.approx(LOCAL[depth], abs=8e-4)


@pytest.mark.parametrize("kind", [jv, hankel1])
def test_waves_of_the_continuum_under_gravity(kind: Callable[[float, float], complex]) -> None:
    """``(h^(1/3) u')' = -omega^2 u`` for ``u = h^(1/3) Z_2/5(6/5 omega h^(5/6))``, by differences."""
    omega, h, d = 0.3, 40.0, 1e-2

    def wave(depth: float) -> complex:
        return complex(depth ** (1 / 3) * kind(0.4, 1.2 * omega * depth ** (5 / 6)))

    def flux(depth: float) -> complex:
        return float(np.cbrt(depth)) * (wave(depth + d / 2) - wave(depth - d / 2)) / d

    left = (flux(h + d / 2) - flux(h - d / 2)) / d
    assert abs(left + omega**2 * wave(h)) < 1e-6 * abs(omega**2 * wave(h))


def test_powers_of_depth_are_found() -> None:
    assert weak.power_of_depth((3e-6 * weak.FIT_DEPTHS**-0.25).tolist()) == pytest.approx(-0.25, rel=1e-12)


def test_a_leading_peak_is_found_between_samples_and_through_rounding() -> None:
    time = np.arange(0.0, 15.0, 0.1)
    noise = 1e-4 * np.random.default_rng(1).normal(size=time.size)
    signal = np.exp(-((time - 4.03) ** 2) / 2) + 2 * np.exp(-((time - 12.0) ** 2) / 2)
    found, rough = weak.leading_peak(time, signal), weak.leading_peak(time, signal + noise)
    assert (found.time_s, found.value) == pytest.approx((4.03, 1.0), abs=2e-5)
    assert (rough.time_s, rough.value) == pytest.approx((4.03, 1.0), abs=2e-4)
