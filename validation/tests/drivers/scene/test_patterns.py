"""Tests of patterns, tapers, ranges of beads and leaning chains."""

from pathlib import Path

import numpy as np
import pytest

from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.engines import codes, load_engine
from drivers.limits.refusal import inability
from validation.accuracy.budget import budget_of
from validation.accuracy.plan import plan_case
from validation.checks import FAIL
from validation.tests.helpers.runs import finished, need
from validation.tests.helpers.scenes import case_of

KEYS = ("chain.sensors=[]", "chain.mass=", "run.duration=0.2 ms")
DIMER = "chain.pattern=[{}, {material='steel', diameter='3 mm'}]"


def random_patterned(number: int, *settings: str) -> Case:
    """Random chain with a pattern, and at random a taper, a range of other beads, a load, a gap or a leaning axis."""
    draw = np.random.default_rng(number)
    members = [
        f"{{material='{draw.choice(['ptfe', 'steel', 'brass', 'glass'])}', diameter='{draw.uniform(2, 9):.3f} mm'}}"
        for _ in range(int(draw.integers(2, 5)))
    ]
    count = int(draw.integers(len(members) + 4, 30))
    keys = [f"chain.count={count}", f"chain.pattern=[{', '.join(members)}]", "chain.sensors=[]", "chain.mass=", "tube="]
    further = (
        f"chain.taper={draw.uniform(0.95, 1.05):.4f}",
        "chain.bead=[{from_wall='2-4', mass='0.3 g'}, "
        f"{{from_wall={count}, gap_below='{draw.uniform(1, 50):.3f} um'}}]",
        f"chain.precompression={10 ** draw.uniform(-2, 1):.4g} N",
        f"chain.angle={draw.uniform(0, 90):.3f} deg",
        "wall=",
    )
    keys += [each for each in further if draw.random() < 0.5]
    return case_of("fig4", *keys, f"striker.speed={10 ** draw.uniform(-2, 0.5):.4g} m/s", *KEYS[2:], *settings)


def test_a_pattern_is_the_table_of_its_beads() -> None:
    members = [f"{{from_wall={place}, material='steel', diameter='3 mm'}}" for place in range(2, 21, 2)]
    short = case_of("fig4", *KEYS, DIMER, "chain.bead=[{from_wall=['3', '7-9'], mass='0.2 g'}]")
    others = [f"{{from_wall={place}, mass='0.2 g'}}" for place in (3, 7, 9)]
    members[3] = members[3].replace("}", ", mass='0.2 g'}")
    long = case_of("fig4", *KEYS, f"chain.bead=[{', '.join([*members, *others])}]")
    for engine in ("liggghts", "yade", "lammps", "verlet", "reference"):
        assert load_engine(engine).render(short).files == load_engine(engine).render(long).files


def test_tapers_keep_the_density() -> None:
    by_ratio = case_of("fig4", "chain.sensors=[]", "chain.taper=0.9").chain
    assert by_ratio.radius_m[20] == pytest.approx(2.38e-3 * 0.9**20, rel=1e-12)
    assert by_ratio.mass_kg[20] == pytest.approx(1.226e-4 * 0.9**60, rel=1e-12)
    linear = case_of("fig4", "chain.sensors=[]", "chain.taper_to=2.38 mm").chain
    np.testing.assert_allclose(np.diff(linear.radius_m[:21]), -2.38e-3 / 2 / 20, rtol=1e-10)
    np.testing.assert_allclose(linear.mass_kg[:21] / linear.radius_m[:21] ** 3, 1.226e-4 / 2.38e-3**3, rtol=1e-12)


def test_a_leaning_chain_feels_the_part_of_gravity_along_its_axis() -> None:
    upright, leaning, flat = (case_of("fig4", f"chain.angle={angle}") for angle in ("0 deg", "60 deg", "90 deg"))
    np.testing.assert_allclose(leaning.chain.load_N, upright.chain.load_N / 2, rtol=1e-14)
    assert not flat.chain.load_N.any()
    assert not flat.models("gravity")
    assert "horizontal" in next(each.reason for each in flat.elements if each.name == "gravity")
    for engine in codes():
        one, other = (load_engine(engine).render(each).files for each in (flat, case_of("fig4", "gravity=")))
        for name in one:
            assert one[name].replace("; leaning by 90 deg: z is the axis, gravity along it 0 m/s^2", "") == other[name]
    assert "leaning by 60 deg: z is the axis, gravity along it 4.905 m/s^2" in leaning.summary


@pytest.mark.long
@pytest.mark.parametrize("number", range(6))
def test_codes_agree_with_their_scheme(number: int, tmp_path: Path) -> None:
    case = random_patterned(number)
    for engine in codes():
        need(engine)
        if inability(case, engine) is None:
            checks = budget_of(case, engine, finished(case, engine, tmp_path).trace).checks
            model = {check.quantity: check.verdict for check in checks if check.quantity.startswith("model: ")}
            assert model.keys() == {"model: force", "model: energy", "model: momentum"}
            assert FAIL not in model.values(), engine


@pytest.mark.accuracy
@pytest.mark.parametrize("number", range(15))
def test_accuracy_asked_is_accuracy_kept(number: int) -> None:
    case = plan_case(random_patterned(100 + number, "run.time_step=", "run.accuracy=1e-4"))
    checks = budget_of(case, "verlet", verlet_of(case)).checks
    assert "error: force" in {check.quantity for check in checks}
    assert not [check for check in checks if check.verdict == FAIL]


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("chain.pattern=[]", "chain.pattern: found 0 members; allowed: 1 to 21"),
        ("chain.pattern=[{material='wood'}]", 'chain.pattern.0.material: found "wood"'),
        ("chain.pattern=[{size='1 mm'}]", "chain.pattern.0.size: unknown key"),
        ("chain.pattern=[{diameter='0 mm'}]", "chain.pattern.0.diameter: found"),
        (f"chain.pattern=[{'{}, ' * 22}]", "chain.pattern: found 22 members; allowed: 1 to 21"),
        ("chain.taper=0", "chain.taper: found 0; allowed: 0.01 or more"),
        ("chain.taper=nan", "chain.taper: found nan"),
        ("chain.taper=0.1", "a ratio closer to 1, or fewer beads"),
        ("chain.taper_to=-1 mm", "chain.taper_to: found"),
        ("chain.angle=91 deg", "chain.angle: found"),
        ("chain.angle=-1 deg", "chain.angle: found"),
        ("chain.angle=30", "an angle from 0 to 90 deg with its unit"),
        (
            "chain.bead=[{from_wall='9-5', mass='1 g'}]",
            'chain.bead.0.from_wall: found "9-5"; allowed: a bead such as 5',
        ),
        ("chain.bead=[{from_wall='0-3', mass='1 g'}]", 'chain.bead.0.from_wall: found "0-3"'),
        ("chain.bead=[{from_wall=[], mass='1 g'}]", "chain.bead.0.from_wall: found []"),
        ("chain.bead=[{from_wall=[3, '2-4'], mass='1 g'}]", "chain.bead.0.from_wall: found 3 twice"),
        ("chain.bead=[{from_wall='20-30', mass='1 g'}]", "chain.bead.0.from_wall: found 22; allowed: 1 to 21"),
        (
            "chain.bead=[{from_wall=1}, {from_wall='2-9', mass='1 m'}]",
            ': chain.bead.1.mass: found "1 m"; allowed',
        ),
        ("chain.bead=[{from_wall='2-9', mas='1 g'}]", ": chain.bead.0.mas: unknown key; did you mean mass?"),
        ("chain.bead=[{from_wall='2-9', material='wood'}]", ': chain.bead.0.material: found "wood"; allowed: alumina'),
        ("chain.bead=[{from_wall='2-6', mass='1 g'}, {from_wall=3}]", ": chain.bead.1.from_wall: found 3 twice"),
        ("chain.bead=[{from_wall='1-999999999', mass='1 g'}]", 'chain.bead.0.from_wall: found "1-999999999"'),
    ],
)
def test_wrong_values_are_named_in_one_line(setting: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        case_of("fig4", "chain.sensors=[]", setting)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (("chain.taper=0.9", "chain.taper_to=2 mm"), "both taper and taper_to"),
        (("chain.taper_to=2 mm", DIMER), "for a pattern with diameters"),
        (("chain.angle=10 deg", "chain.lateral_offset=30 um"), "chain.angle: found 10 deg for beads that move"),
    ],
)
def test_keys_that_exclude_each_other(settings: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        case_of("fig4", "chain.sensors=[]", *settings)
