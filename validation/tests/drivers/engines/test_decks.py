"""Tests of decks: snapshots of the paper's scenes; no lines for elements that a scene does not have."""

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.base.decks import Deck
from drivers.base.processes import STDOUT, run_command
from drivers.chain.case import Case
from drivers.chain.trace import digest_of
from drivers.engines import codes, installed_codes, load_engine
from drivers.run.guard import checked_trace
from drivers.run.run import run_case
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import case_of

SNAPSHOTS = Path(__file__).parent / "decks"
PAPER = ("fig4", "fig5", "fig6b", "fig6d")


@pytest.mark.parametrize("engine", codes())
@pytest.mark.parametrize("scene", PAPER)
def test_decks_of_the_paper_stay_as_they_are(scene: str, engine: str, request: pytest.FixtureRequest) -> None:
    for name, text in load_engine(engine).render(case_of(scene)).files.items():
        kept = SNAPSHOTS / f"{scene}.{engine}.{name}.txt"
        if request.config.getoption("--update-decks"):
            kept.write_text(text)
        assert text == kept.read_text(), f"{kept.name} differs; if it should: pytest --update-decks"


# a setting that removes (or adds) the element in fig4, and the word of each deck that models it
NEEDED_BY = {
    "precompression": ("chain.precompression=2 N", {"lammps": "addforce", "liggghts": "addforce", "yade": "setPermF"}),
    "gravity": ("gravity=", dict.fromkeys(("lammps", "liggghts", "yade"), "gravity")),
    "damping": ("contact.restitution=0.9", {"lammps": "tsuji", "liggghts": "limitForce", "yade": "betan"}),
    "wall": ("wall=", {"lammps": "wall/gran", "liggghts": "wall/gran", "yade": "utils.wall"}),
}


@pytest.mark.parametrize("element", NEEDED_BY)
@pytest.mark.parametrize("engine", codes())
def test_no_line_for_an_element_that_is_out(element: str, engine: str) -> None:
    setting, words = NEEDED_BY[element]

    def main_file(*settings: str) -> str:
        files = load_engine(engine).render(case_of("fig4", *settings)).files
        return next(text for name, text in files.items() if name in ("chain.in", "chain.py"))

    for settings in ((), (setting,)):
        assert (words[engine] in main_file(*settings)) == case_of("fig4", *settings).models(element)
    assert case_of("fig4").models(element) != case_of("fig4", setting).models(element)


@pytest.mark.parametrize("engine", codes())
def test_straight_decks_have_no_tube_friction_or_rotation(engine: str) -> None:
    text = "".join(load_engine(engine).render(case_of("fig4", "contact.friction=0.3")).files.values()).lower()
    for word in ("cylinder", "facet", "coefficientfriction", "nve/sphere", "tangential history", "inertia ="):
        assert word not in text


# the same for fig4 in its tube
IN_TUBES: dict[str, tuple[tuple[str, ...], dict[str, tuple[str, ...]]]] = {
    "friction": (
        ("contact.friction=0", "tube.friction=0"),
        {
            "liggghts": ("coefficientFriction", "tangential history", "contact_distance_factor", "tangential_damping"),
            "yade": ("kso", "forget", "tangensOfFrictionAngle", "slipping", "shearElastic"),
        },
    ),
    "rotation": (
        ("contact.rotation=false",),
        {"liggghts": ("nve/sphere", "omega"), "yade": ("inertia", "spin", "torque", "angVel")},
    ),
    "tube": (
        ("tube=", "chain.lateral_offset=", "chain.bead=[{from_wall=3, lateral_velocity='1 m/s'}]"),
        {"liggghts": ("zcylinder", "hertz/stiffness", "fix kn", "_tube"), "yade": ("acet", "bore", "follow", "math")},
    ),
    "damping": (("contact.restitution=0.9",), {"liggghts": ("limitForce", "fix damping"), "yade": ("betan",)}),
    "precompression": (("chain.precompression=2 N",), {"liggghts": ("addforce",), "yade": ("setPermF",)}),
    "gravity": (("gravity=",), {"liggghts": ("gravity",), "yade": ("gravity", "\ng = ")}),
    "wall": (("wall=",), {"liggghts": ("zplane", "f_force_wall"), "yade": ("utils.wall", "on_wall", "[wall]")}),
}


@pytest.mark.parametrize("element", IN_TUBES)
@pytest.mark.parametrize("engine", ["liggghts", "yade"])
def test_no_line_in_a_tube_for_an_element_that_is_out(element: str, engine: str) -> None:
    settings, words = IN_TUBES[element]
    usual, other = case_of("fig4-tube"), case_of("fig4-tube", *settings)
    assert usual.models(element) != other.models(element)
    for case in (usual, other):
        files = load_engine(engine).render(case).files
        text = next(text for name, text in files.items() if name in ("chain.in", "chain.py"))
        assert {word: word in text for word in words[engine]} == dict.fromkeys(words[engine], case.models(element))


@pytest.mark.parametrize("engine", ["liggghts", "yade"])
@pytest.mark.parametrize("rough", ["contact.friction", "tube.friction"])
def test_each_friction_has_lines_of_its_own(rough: str, engine: str) -> None:
    only = {"contact.friction": 0.0, "tube.friction": 0.0} | {rough: 0.3}
    case = case_of("fig4-tube", *(f"{key}={value}" for key, value in only.items()))
    files = load_engine(engine).render(case).files
    text = next(text for name, text in files.items() if name in ("chain.in", "chain.py"))
    between = rough == "contact.friction"
    lines = text.splitlines()
    if engine == "liggghts":
        for start, slips in (("pair_style", between), ("fix wall", between), ("fix tube", not between)):
            line = next(line for line in lines if line.startswith(start))
            assert ("tangential history" in line) == slips
        assert ("contact_distance_factor" in text) == between
        return
    assert ("slipping = contacts" in text) == between
    assert ("slipping = in_bore" in text) != between
    assert f"tangensOfFrictionAngle = {only['tube.friction']:g}" in text


def by_hand(case: Case, engine: str, deck: Deck, folder: Path) -> str:
    """Digest of the forces of a deck that runs in a folder."""
    code = load_engine(engine)
    folder.mkdir()
    deck.write(folder)
    outcome = run_command(code.started(deck, code.find() or ()), folder, 60, **code.environment)
    return digest_of(checked_trace(case, code, outcome, folder))


@pytest.mark.parametrize("scene", ["fig4", "fig4-tube"])
def test_the_line_that_checks_the_step_works_and_changes_no_force(scene: str, tmp_path: Path) -> None:
    need("liggghts")
    for step, warned in (("0.5 us", False), ("5 us", True)):
        times = ("run.duration=50 us", "run.sample_interval=5 us", f"run.time_step={step}")
        case = case_of(scene, *times, "contact.restitution=0.8")
        deck = load_engine("liggghts").render(case)
        main = deck.files["chain.in"]
        checking = replace(deck, files={**deck.files, "chain.in": main.replace("# fix check", "fix check")})
        assert checking != deck
        folder = tmp_path / f"checked at {step}"
        assert by_hand(case, "liggghts", checking, folder) == by_hand(case, "liggghts", deck, tmp_path / step)
        assert ("WARNING: time-step is" in (folder / STDOUT).read_text()) == warned


@pytest.mark.parametrize("settings", [(), ("contact.restitution=0.8",)])
def test_decks_without_moduli_or_with_a_tuned_one_have_no_line_that_checks_the_step(settings: tuple[str, ...]) -> None:
    assert "check/timestep" not in load_engine("liggghts").render(case_of("fig5", *settings)).files["chain.in"]


LOGGED = [name for name in installed_codes() if load_engine(name).render(case_of("fig4")).logs]


@pytest.mark.parametrize("engine", LOGGED)
def test_a_deck_by_hand_writes_a_log_and_a_run_folder_has_none(engine: str, tmp_path: Path) -> None:
    case = case_of("fig4", "run.duration=20 us")
    by_hand(case, engine, load_engine(engine).render(case), tmp_path / "hand")
    (log,) = (tmp_path / "hand").glob("log.*")
    assert "timestep" in log.read_text()
    assert not [*run_case(case, engine, tmp_path / "runs").folder.glob("log.*")]


def test_titles_of_data_files_are_short() -> None:
    """LIGGGHTS reads a title of more than 255 characters as two lines."""
    damped = ("chain.angle=77.5 deg", "contact.restitution=0.8", "drive.start=58.123456 us")
    for engine in ("lammps", "liggghts"):
        title = load_engine(engine).render(case_of("driven-steel", *damped)).files["chain.data"].partition("\n")[0]
        assert len(title) < 255
