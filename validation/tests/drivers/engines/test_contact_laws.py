"""Laws of dissipation: reference, order, restitution, codes, plans, refusals."""

import re
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest
from scipy.special import beta

from drivers.base.errors import InputError
from drivers.chain.chain import arrays_of
from drivers.chain.schemes import exact_of, heights_and_reach, trace_of, verlet_of
from drivers.engines import codes, engine_names, load_engine
from drivers.laws import LAWS, Dissipation, damping_ratio_of, restitution_of
from drivers.limits import inability
from drivers.run.run import run_all_done
from postproc.read.observables import energy_error_J
from validation.accuracy.budget import MODEL, budget_of, missed_accuracy
from validation.accuracy.motions import exact_motion_of
from validation.checks import PASS
from validation.reference.adaptive import integrate_adaptive
from validation.reference.velocity_verlet import integrate_verlet, integrate_verlet_absolute
from validation.tests.helpers import high_precision
from validation.tests.helpers.by_power import forces_at
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import assessed, finished, need
from validation.tests.helpers.scenes import case_of

POWER, KUWABARA_KONO = "contact.dissipation=power", "contact.dissipation=kuwabara-kono"
EXAMPLES = {  # a setting of each law
    "hunt-crossley": "contact.slowness=0.2 s/m",
    "kuwabara-kono": "contact.relaxation=2 us",
    "power": "contact.gamma=3",
    "viscoelastic": "contact.restitution=0.9",
}
SETTINGS = {law: (f"contact.dissipation={law}", EXAMPLES[law]) for law in LAWS} | {
    "dashpot": (POWER, "contact.gamma=3", "contact.alpha=1"),
    "cubic power": (POWER, "contact.gamma=10", "contact.alpha=3"),
}
MOVING = "chain.bead=[{from_wall=20, velocity='-0.5 m/s'}]"
WIDE_GAP = ("chain.count=3000", 'chain.bead=[{from_wall=9, gap_below="1 m"}]')
KICKED = ("drive.form=step", "drive.force=1 N", "drive.from_wall=5")
LEANING = (  # contacts that lean close at speeds across the axis, which YADE has half a step earlier
    "chain.lateral_offset=30 um", "chain.count=6", "chain.sensors=[]", "striker=", "chain.precompression=5 N",
    "chain.bead=[{from_wall=3, lateral_velocity='1 m/s'}]",
)  # fmt: skip
SCENES = {
    "two masses": ("fig4",),
    "flat striker": ("fig5",),
    "two materials": ("fig6b",),
    "pressed and moving": ("fig4", "striker=", "chain.precompression=2 N", MOVING),
}
CASES = [
    *product(LAWS, ("flat striker", "pressed and moving")),
    ("kuwabara-kono", "two masses"),
    ("dashpot", "two masses"),
    ("cubic power", "two materials"),
]
DURATION_S = 4e-4
MANY_MASSES = (*SETTINGS["kuwabara-kono"], "chain.mass_scatter=1 mg", "chain.count=80")
PAIR = ("fig4", "wall=", "gravity=", "chain.sensors=[]", "chain.count=1", "run.duration=0.5 ms")
EXACT = 1e-10  # of the largest force


@pytest.mark.parametrize(("law", "scene"), CASES)
def test_the_reference_is_exact_and_its_energy_never_grows(law: str, scene: str) -> None:
    case = case_of(*SCENES[scene], *SETTINGS[law])
    chain, times = arrays_of(case.chain), np.linspace(0, DURATION_S, 21)
    exact = forces_at(chain, times)
    for asked in (EXACT, 1e-6):
        assert np.abs(integrate_adaptive(chain, times, asked).force_N - exact).max() <= asked * exact.max()
    fine = np.linspace(0, DURATION_S, 1001)
    energy_J = trace_of(case, fine, integrate_adaptive(chain, fine)).total_energy_J
    assert energy_error_J(energy_J, damped=True, slips=False).max() <= 1e-13 * energy_J[0]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("kind", ["light", "flat", "gaps"])
def test_contacts_that_open_close_again_and_let_go_come_out_exact(kind: str, seed: int) -> None:
    chain, times = high_precision.random_chain(kind, seed, 6)
    draw = np.random.default_rng([seed, 99])
    alpha, gamma = float(draw.choice([1, 1.25, 1.75, 2, 3])), 10 ** draw.uniform(-9 * seed, 2.3)
    chain = replace(chain, damping=np.full(6, gamma), alpha=alpha)
    exact = forces_at(chain, times)
    assert np.abs(integrate_adaptive(chain, times).force_N - exact).max() <= EXACT * exact.max()


@pytest.mark.parametrize("power", [0.75, 1.25, 1.5])
@pytest.mark.parametrize("kind", ["light", "flat", "gaps"])
def test_damping_by_any_power_of_the_overlap_comes_out_exact(kind: str, power: float) -> None:
    chain, times = high_precision.random_chain(kind, 3, 6)
    speed = np.abs(chain.velocity_m_s).max()
    deepest = (1.25 * chain.mass_kg.max() * speed**2 / chain.stiffness.max()) ** 0.4
    damping = 0.5 * chain.stiffness * deepest ** (1.5 - power) / speed
    chain = replace(chain, damping=damping, overlap_power=power)
    exact = forces_at(chain, times)
    assert np.abs(integrate_adaptive(chain, times).force_N - exact).max() <= EXACT * exact.max()


@pytest.mark.parametrize("law", SETTINGS)
def test_the_slope_is_the_derivative_of_the_dissipative_force(law: str) -> None:
    chain, speed, change = case_of("fig4", *SETTINGS[law]).chain, 0.7, 1e-5
    overlap, ones = np.full(chain.bodies, 1e-5), np.ones(chain.bodies)
    forces = [chain.law.force(chain.damping, overlap, (speed + side * change) * ones) for side in (-1, 1)]
    slope = chain.law.slope(chain.damping, overlap, speed * ones)
    np.testing.assert_allclose(slope, (forces[1] - forces[0]) / (2 * change), rtol=1e-8)


def test_without_loss_contacts_are_elastic_bit_for_bit() -> None:
    plain = case_of("fig5")
    for settings in (("contact.restitution=1",), (POWER, "contact.gamma=0")):
        case = case_of("fig5", *settings)
        assert not case.chain.damped
        assert case.summary == plain.summary
        np.testing.assert_array_equal(verlet_of(case).force_N, verlet_of(plain).force_N)


def test_bodies_that_just_touch_start_with_the_force_just_after() -> None:
    case = case_of("fig4", *SETTINGS["power"])
    chain, first_N = case.chain, 3 * 2**1.75
    assert chain.force_N[-1] == pytest.approx(first_N, rel=1e-15)
    for motion in (
        integrate_adaptive(arrays_of(chain), case.sample_times_s[:2]),
        integrate_verlet(arrays_of(chain), 1e-7, 10, 2),
        integrate_verlet_absolute(arrays_of(chain), *heights_and_reach(case), 1e-7, 10, 2),
    ):
        assert motion.force_N[0, -1] == pytest.approx(first_N, rel=1e-9)
        np.testing.assert_allclose(motion.force_N[0, :-1], chain.force_N[:-1], rtol=1e-6)
    parting = replace(arrays_of(chain), velocity_m_s=-chain.velocity_m_s)
    assert integrate_verlet(parting, 1e-7, 1, 2).force_N[0, -1] == 0


@pytest.mark.parametrize("law", SETTINGS)
def test_velocity_verlet_is_of_first_order(law: str) -> None:
    case = case_of("fig4", *SETTINGS[law], "run.duration=0.8 ms")
    exact = exact_motion_of(case, finer=False).trace.force_N
    errors = [np.abs(verlet_of(case.at(steps)).force_N - exact).max() for steps in (50, 100, 200)]
    for coarse, fine in pairwise(errors):
        assert np.log2(coarse / fine) == pytest.approx(1, abs=0.1)


def rebound_of(*settings: str) -> float:
    """Restitution of the impact of a pair, from its exact motion."""
    velocity = exact_of(case_of(*PAIR, *settings)).velocity_m_s
    assert velocity is not None
    return float((velocity[-1, 1] - velocity[-1, 0]) / (velocity[0, 0] - velocity[0, 1]))


@pytest.mark.parametrize("wanted", [1e-3, 0.1353352832366127, 0.5, 0.9, 0.999999])
def test_impacts_have_the_restitution_asked_for(wanted: float) -> None:
    assert restitution_of(damping_ratio_of(wanted)) == pytest.approx(wanted, rel=1e-14)
    assert rebound_of(f"contact.restitution={wanted}", "run.duration=20 ms") == pytest.approx(wanted, rel=1e-9)


@pytest.mark.parametrize("speed", [0.01, 1.0, 20.0])
def test_hunt_and_crossley_have_a_restitution_by_speed_alone(speed: float) -> None:
    x, settings = 0.3 * speed, ("contact.dissipation=hunt-crossley", "contact.slowness=0.3 s/m")
    returned = x * rebound_of(f"striker.speed={speed} m/s", *settings)
    assert np.log1p(-returned) + returned == pytest.approx(np.log1p(x) - x, rel=1e-9)


@pytest.mark.parametrize("speed", [0.01, 1.0])
def test_a_weak_loss_of_kuwabara_and_kono_is_that_of_the_elastic_path(speed: float) -> None:
    """``1 - e = 3 A k D^(3/2) / (m* v)`` times the integral of ``sqrt(x - x^(7/2))``, with the largest overlap D."""
    settings = (f"striker.speed={speed} m/s", KUWABARA_KONO, "contact.relaxation=1 ns")
    chain = case_of(*PAIR, *settings).chain
    stiffness, mass = chain.stiffness[1], chain.reduced_mass_kg[1]
    deepest = (1.25 * mass * speed**2 / stiffness) ** 0.4
    lost = 3e-9 * stiffness * deepest**1.5 / (mass * speed) * 0.4 * beta(0.6, 1.5)
    assert 1 - rebound_of(*settings) == pytest.approx(lost, rel=2 * lost + 1e-6)


@pytest.mark.parametrize("engine", codes())
@pytest.mark.parametrize(
    ("law", "scene"),
    [pytest.param(*case, marks=pytest.mark.long if case[1] == "flat striker" else ()) for case in CASES],
)
def test_a_code_agrees_with_its_scheme_or_refuses_the_law_by_name(
    law: str, scene: str, engine: str, shared_runs: Path
) -> None:
    case = case_of(*SCENES[scene], *SETTINGS[law], f"run.duration={DURATION_S} s")
    known = case.chain.law.name in load_engine(engine).dissipation
    if problem := inability(case, engine):
        ((key, found, allowed),) = problem.problems
        assert (key == "contact.dissipation") == (not known)
        assert known or found == f'"{case.chain.law.name}"'
        assert re.fullmatch(f"on {engine} .+|no such velocities, .+", allowed)
        return
    assert known
    run = finished(case, engine, shared_runs)
    assert run.record.warnings == []
    assert run.layout.damped
    assert run.trace.force_N.min() >= -1e-12 * run.trace.force_N.max()  # nothing pulls
    model = [check for check in budget_of(case, engine, run.trace).checks if check.quantity.startswith(MODEL)]
    assert {check.verdict for check in model} == {PASS}


def test_a_law_that_no_engine_names_runs_on_none() -> None:
    case = case_of("fig4")
    unknown = replace(case, chain=replace(case.chain, law=Dissipation("silent", 1.0, "dissipative force")))
    for engine in engine_names():
        assert f'found "silent"; allowed: on {engine} ' in str(inability(unknown, engine))


@pytest.mark.parametrize(
    ("settings", "engine", "message"),
    [
        (
            ("contact.restitution=0.2",),
            "liggghts",
            "found a restitution of 0.2; allowed: on liggghts above 0.2137",
        ),
        (
            ("contact.damping_ratio=0.7",),
            "liggghts",
            "on liggghts above 0.2137, which is a damping_ratio below 0.63",
        ),
        (("contact.restitution=0.214",), "liggghts", ""),
        (("contact.restitution=0.9", MOVING), "yade", "bead 20 pressed, and moving or driven,"),
        ((MOVING,), "yade", ""),
        ((*KICKED, "contact.restitution=0.9"), "yade", "drive.start: found bead 5 pressed, and moving or driven,"),
        ((*KICKED, "contact.restitution=0.9", "drive.start=1 us"), "yade", ""),
        (KICKED, "yade", ""),
        ((*LEANING, "contact.restitution=0.9"), "yade", "bead 3 pressed, and moving or driven,"),
        (LEANING, "yade", ""),
        (SETTINGS["power"], "lammps", 'on lammps 1, or contact.dissipation = "viscoelastic"'),
        (SETTINGS["power"], "liggghts", 'on liggghts "kuwabara-kono" or "viscoelastic"'),
        (SETTINGS["hunt-crossley"], "lammps", 'on lammps "kuwabara-kono" or "power" or "viscoelastic"'),
        (SETTINGS["hunt-crossley"], "liggghts", 'on liggghts "kuwabara-kono" or "viscoelastic"'),
        (WIDE_GAP, "kratos", "within the reach of 2 m that they need; allowed: on kratos at most 1e+06 pairs"),
        (WIDE_GAP, "lammps", ""),
        (MANY_MASSES, "lammps", "with 80 kinds of beads"),
        (MANY_MASSES, "liggghts", "with 80 kinds of beads"),
        (MANY_MASSES, "yade", ""),
    ],
)
def test_codes_refuse_by_name_what_they_lack(settings: tuple[str, ...], engine: str, message: str) -> None:
    problem = inability(case_of("fig4", *settings), engine)
    assert (problem is not None) == bool(message)
    assert message in str(problem)


@pytest.mark.parametrize("more", [(), ("--unsafe",), ("--rerun",)])
def test_the_command_refuses_a_law_before_it_renders_a_deck(more: tuple[str, ...], tmp_path: Path) -> None:
    """There is no deck of the case to find a finished run by."""
    need("liggghts")
    words = [word for setting in SETTINGS["power"] for word in ("--set", setting)]
    refused = beads("run", "fig4", *words, "--engine", "liggghts", "--runs", tmp_path, *more)
    assert (refused.returncode, refused.stdout, len(refused.stderr.splitlines())) == (2, "", 1)
    assert 'on liggghts "kuwabara-kono" or' in refused.stderr
    with pytest.raises(InputError, match='on liggghts "kuwabara-kono" or'):
        run_all_done([(case_of("fig4", *SETTINGS["power"]), "liggghts")], tmp_path)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ((POWER,), "contact.gamma: missing key; give a number of 0 or more"),
        (("contact.gamma=3",), 'contact.gamma: found 3.0 with contact.dissipation = "viscoelastic"'),
        ((*SETTINGS["power"], "contact.restitution=0.9"), "contact.restitution: found 0.9 with contact.dissipation"),
        ((POWER, "contact.gamma=-1"), "contact.gamma: found -1; allowed: greater than or equal to 0"),
        ((*SETTINGS["power"], "contact.alpha=0.9"), "contact.alpha: found 0.9; allowed: greater than or equal to 1"),
        ((*SETTINGS["power"], "contact.alpha=3.1"), "contact.alpha: found 3.1; allowed: less than or equal to 3"),
        (("contact.dissipation=linear",), f"allowed: {', '.join(map(repr, [*LAWS][:-1]))} or {[*LAWS][-1]!r}"),
        ((*SETTINGS["power"], "chain.lateral_offset=30 um"), "beads that move sideways"),
        (("contact.dissipation=hunt-crossley",), "contact.slowness: missing key; give an inverse speed"),
        ((KUWABARA_KONO,), 'contact.relaxation: missing key; give a time, such as "1 us"'),
        ((KUWABARA_KONO, "contact.relaxation=0 s"), "contact.relaxation: found"),
        ((KUWABARA_KONO, "contact.relaxation=1"), "a time above zero with its unit"),
        (("contact.relaxation=2 us",), 'this key only with contact.dissipation = "kuwabara-kono"'),
        ((*SETTINGS["kuwabara-kono"], "chain.lateral_offset=30 um"), "beads that move sideways"),
    ],
)
def test_wrong_keys_are_named_in_one_line(settings: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError) as error:
        case_of("fig4", *settings)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("law", "engine"), [("viscoelastic", "yade"), ("kuwabara-kono", "lammps"), ("power", "verlet")]
)
def test_an_accuracy_is_kept(law: str, engine: str, shared_runs: Path) -> None:
    need(engine)
    ended = assessed(case_of("fig4", *SETTINGS[law], "run.time_step=", "run.accuracy=1e-3"), engine, shared_runs)
    assert ended.done
    assert missed_accuracy(ended) == ""
