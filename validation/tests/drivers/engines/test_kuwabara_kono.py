"""Tests of the law of Kuwabara and Kono: reference, restitution, codes, planned accuracy, files of a law."""

from pathlib import Path

import numpy as np
import pytest
from scipy.special import beta

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.chain import arrays_of
from drivers.chain.schemes import exact_of, verlet_of
from drivers.limits.refusal import inability
from validation.accuracy.budget import budget_of
from validation.accuracy.plan import plan_case
from validation.checks import PASS
from validation.reference.adaptive import integrate_adaptive
from validation.tests.helpers.by_power import forces_at
from validation.tests.helpers.runs import finished, need
from validation.tests.helpers.scenes import case_of

LAW = ("contact.dissipation=kuwabara-kono", "contact.relaxation=2 us")
MOVING_BEADS = "chain.bead=[{from_wall=20, velocity='-0.5 m/s'}]"  # beads that move and are pressed at time 0
SCENES = {
    "sensor beads of another mass": ("fig4",),
    "flat striker": ("fig5", "run.duration=0.5 ms"),
    "two materials": ("fig6b",),
    "pressed and moving": ("fig4", "striker=", "chain.precompression=2 N", MOVING_BEADS),
    "free chain": ("fig4", "wall=", "gravity="),
}


def damped(scene: str, *settings: str) -> Case:
    """Case with the law."""
    return case_of(scene, *LAW, *settings)


@pytest.mark.parametrize("name", SCENES)
def test_the_reference_is_exact(name: str) -> None:
    case = damped(*SCENES[name])
    times = np.linspace(0, 4e-4, 21)
    exact = forces_at(arrays_of(case.chain), times)
    error = np.abs(integrate_adaptive(arrays_of(case.chain), times).force_N - exact).max() / exact.max()
    assert error <= 1e-10


@pytest.mark.parametrize("engine", ["lammps", "liggghts", "yade"])
@pytest.mark.parametrize("name", SCENES)
def test_codes_agree_with_their_scheme(name: str, engine: str, tmp_path: Path) -> None:
    need(engine)
    case = damped(*SCENES[name])
    run = finished(case, engine, tmp_path)
    difference = np.abs(run.trace.force_N - verlet_of(case).force_N).max()
    assert difference < tolerance("model", "force").limit * run.trace.force_N.max()


@pytest.mark.parametrize("speed", [0.01, 1.0])
def test_a_weak_loss_is_that_of_the_elastic_path(speed: float) -> None:
    """``1 - e = 3 A k D^(3/2) / (m* v)`` times the integral of ``sqrt(x - x^(7/2))``, with the largest overlap D."""
    relaxation = 1e-9
    free = ("wall=", "gravity=", "chain.sensors=[]", "chain.count=1", f"striker.speed={speed} m/s")
    case = damped("fig4", *free, f"contact.relaxation={relaxation} s", "run.duration=0.5 ms")
    chain = case.chain
    stiffness, mass = chain.stiffness[1], chain.reduced_mass_kg[1]
    deepest = (1.25 * mass * speed**2 / stiffness) ** 0.4
    lost = 3 * relaxation * stiffness * deepest**1.5 / (mass * speed) * 0.4 * beta(0.6, 1.5)
    velocity = exact_of(case).velocity_m_s
    assert velocity is not None
    rebound = (velocity[-1, 1] - velocity[-1, 0]) / speed
    assert 1 - rebound == pytest.approx(lost, rel=2 * lost + 1e-6)


def test_an_accuracy_is_kept(tmp_path: Path) -> None:
    need("lammps")
    case = plan_case(damped("fig4", "run.time_step=", "run.accuracy=1e-3"))
    run = finished(case, "lammps", tmp_path)
    checks = budget_of(case, "lammps", run.trace).checks
    assert {check.verdict for check in checks} == {PASS}
    assert {check.limit for check in checks if check.quantity == "error: force"} == {1e-3}


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (LAW[:1], 'contact.relaxation: missing key; give a time, such as "1 us"'),
        ((*LAW, "contact.relaxation=0 s"), "contact.relaxation: found"),
        ((*LAW, "contact.relaxation=-1 us"), "a time above zero with its unit"),
        ((*LAW, "contact.relaxation=1"), "a time above zero with its unit"),
        (LAW[1:], 'this key only with contact.dissipation = "kuwabara-kono"'),
        ((*LAW, "seed=1", "chain.lateral_offset=30 um"), "beads that move sideways"),
    ],
)
def test_wrong_keys_are_named_in_one_line(settings: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError) as error:
        case_of("fig4", *settings)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_too_many_masses_are_refused_by_name() -> None:
    scattered = damped("fig4", "chain.mass_scatter=1 mg", "chain.count=80")
    for engine in ("lammps", "liggghts"):
        assert "with 80 kinds of beads" in str(inability(scattered, engine))
    assert inability(scattered, "yade") is None


def test_a_law_is_its_module_and_a_line_of_a_template() -> None:
    """LIGGGHTS' template has a comment on A; the name is in that of LAMMPS."""
    sources = [*(paths.ROOT / "drivers").rglob("*.py"), *(paths.ROOT / "postproc").rglob("*.py")]
    sources += [path for path in (paths.ROOT / "validation").rglob("*.py") if "tests" not in path.parts]
    sources += [*(paths.ROOT / "templates").rglob("*.j2")]
    naming = {path.relative_to(paths.ROOT).as_posix() for path in sources if "uwabara" in path.read_text()}
    assert naming == {"drivers/laws/kuwabara_kono.py", "templates/lammps/chain.in.j2"}
