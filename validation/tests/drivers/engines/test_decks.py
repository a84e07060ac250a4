"""Decks: snapshots of the paper's scenes, no lines for elements that a scene does not have, checks and logs."""

from pathlib import Path

import pytest

from drivers.base.processes import STDERR, STDOUT, run_command
from drivers.engines import codes, installed_codes, load_engine
from drivers.limits import inability
from drivers.run.compute import compute
from drivers.run.run import run_case
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import case_of

SNAPSHOTS = Path(__file__).parent / "decks"
PAPER = ("fig4", "fig5", "fig6b", "fig6d")
SCENES = {"kratos": "fig4", "lammps": "fig4-tube", "liggghts": "fig4-tube", "yade": "fig4-tube"}
# settings that remove (or add) the element, and the words of each deck that models it
NEEDED_BY: dict[str, tuple[tuple[str, ...], dict[str, tuple[str, ...]]]] = {
    "friction": (
        ("contact.friction=0", "tube.friction=0"),
        {
            "lammps": ("mindlin", "friction"),
            "liggghts": ("tangential history", "contact_distance_factor", "tangential_damping"),
            "yade": ("kso", "forget", "tangensOfFrictionAngle", "slipping", "shearElastic"),
        },
    ),
    "rotation": (
        ("contact.rotation=false",),
        {
            "lammps": ("nve/sphere", "omega"),
            "liggghts": ("nve/sphere", "omega"),
            "yade": ("inertia", "spin", "torque", "angVel"),
        },
    ),
    "tube": (
        ("tube=", "chain.lateral_offset=", "chain.bead=[{from_wall=3, lateral_velocity='1 m/s'}]"),
        {
            "lammps": ("zcylinder", "tube", "bore"),
            "liggghts": ("zcylinder", "hertz/stiffness", "fix kn", "_tube"),
            "yade": ("acet", "bore", "follow", "math"),
        },
    ),
    "damping": (
        ("contact.restitution=0.9",),
        {
            "kratos": ("DAMPING_GAMMA",),
            "lammps": ("tsuji",),
            "liggghts": ("limitForce", "fix damping"),
            "yade": ("betan",),
        },
    ),
    "precompression": (
        ("chain.precompression=2 N",),
        {
            "kratos": ("EXTERNAL_APPLIED_FORCE_Z",),
            "lammps": ("addforce",),
            "liggghts": ("addforce",),
            "yade": ("setPermF",),
        },
    ),
    "gravity": (
        ("gravity=",),
        {"kratos": ("GRAVITY",), "lammps": ("gravity",), "liggghts": ("gravity",), "yade": ("gravity", "\ng = ")},
    ),
    "wall": (
        ("wall=",),
        {
            "kratos": ("RigidFace", "FOR_WALLS", "walls.Add"),
            "lammps": ("zplane", "f_wall"),
            "liggghts": ("zplane", "f_force_wall"),
            "yade": ("utils.wall", "[wall]"),
        },
    ),
}


def text_of(engine: str, scene: str, *settings: str) -> str:
    """Main file of a deck."""
    files = load_engine(engine).render(case_of(scene, *settings)).files
    return next(text for name, text in files.items() if name in ("chain.in", "chain.py"))


@pytest.mark.parametrize("engine", codes())
@pytest.mark.parametrize("scene", PAPER)
def test_decks_of_the_paper_stay_as_they_are(scene: str, engine: str, request: pytest.FixtureRequest) -> None:
    for name, text in load_engine(engine).render(case_of(scene)).files.items():
        kept = SNAPSHOTS / f"{scene}.{engine}.{name}.txt"
        if request.config.getoption("--update-decks"):
            kept.write_text(text)
        assert text == kept.read_text(), f"{kept.name} differs; if it should: pytest --update-decks"


@pytest.mark.parametrize(
    ("element", "engine"), [(element, engine) for element, (_, words) in NEEDED_BY.items() for engine in words]
)
def test_no_line_for_an_element_that_is_out(element: str, engine: str) -> None:
    change, words = NEEDED_BY[element]
    modelled = []
    for settings in ((), change):
        text = text_of(engine, SCENES[engine], *settings)
        modelled.append(element in case_of(SCENES[engine], *settings).reasons)
        assert {word: word in text for word in words[engine]} == dict.fromkeys(words[engine], modelled[-1])
    assert modelled[0] != modelled[1]


@pytest.mark.parametrize(
    "scene", ["fig4", *(pytest.param(name, marks=pytest.mark.long) for name in ("fig5", "fig4-tube", "driven-steel"))]
)
@pytest.mark.parametrize("engine", codes())
def test_a_code_prints_no_warning_unless_its_check_of_the_step_fails(engine: str, scene: str, tmp_path: Path) -> None:
    need(engine)
    short, coarse = "run.duration=50 us", ("run.sample_interval=5 us", "run.time_step=5 us")
    checks = any(word in text_of(engine, scene) for word in ("fix check", "PWaveTimeStep"))
    for name, settings, warned in (
        ("elastic", (short,), False),
        ("damped", (short, "contact.restitution=0.8"), False),
        ("coarse", (short, *coarse), checks),
    ):
        case = case_of(scene, *settings)
        if inability(case, engine):
            continue
        (folder := tmp_path / name).mkdir()
        compute(case, engine, folder=folder)
        printed = "".join((folder / log).read_text() for log in (STDOUT, STDERR)).lower()
        assert ("warning" in printed) == warned, printed


LOGGED = [name for name in installed_codes() if load_engine(name).render(case_of("fig4")).logs]


@pytest.mark.parametrize("engine", LOGGED)
def test_a_deck_by_hand_writes_a_log_and_a_run_folder_has_none(engine: str, tmp_path: Path) -> None:
    case = case_of("fig4", "run.duration=20 us")
    code, deck = load_engine(engine), load_engine(engine).render(case)
    deck.write(tmp_path)
    assert run_command(code.started(deck, code.find() or ()), tmp_path, 60, **code.environment).code == 0
    (log,) = tmp_path.glob("log.*")
    assert "timestep" in log.read_text()
    assert not [*run_case(case, engine, tmp_path / "runs").folder.glob("log.*")]


@pytest.mark.parametrize("engine", ["lammps", "liggghts"])
def test_titles_of_data_files_are_short(engine: str) -> None:
    """LIGGGHTS reads a title of more than 255 characters as two lines."""
    damped = ("chain.angle=77.5 deg", "contact.restitution=0.8", "drive.start=58.123456 us")
    data = load_engine(engine).render(case_of("driven-steel", *damped)).files["chain.data"]
    assert len(data.partition("\n")[0]) < 255
