"""Bad input ends with one line that names the file, the key, the value found and the values allowed."""

import time
from pathlib import Path

import pytest

from drivers.base.errors import CONTROL, InputError
from drivers.chain.case import build_case
from drivers.limits import refuse
from drivers.scene.read_scene import read_scene
from validation.tests.helpers.commands import assert_in_order, beads
from validation.tests.helpers.scenes import SceneWriter

# settings of fig4, and parts of the message in order: key, value found, values allowed
BAD = [
    ("grvity=1", "grvity", "unknown key", "gravity"),
    ("name=x", "name", "unknown key", "chain"),
    ("drive.time_s=[0.0]", "drive.time_s", "unknown key", "force"),
    ("chain.count=", "chain.count", "missing key", ""),
    ("chain.count=2.5", "chain.count", "2.5", "integer"),
    ("chain.count=1000000000000", "chain.count", "1000000000000", "less than or equal to"),
    ("chain.mass=2 mm", "chain.mass", "2 mm", "a mass above zero"),
    ("chain.mass=0.1226", "chain.mass", "0.1226", 'with its unit, such as "0.1226 g"'),
    ("chain.mass=٣ g", "chain.mass", "٣ g", "a mass"),
    ("chain.mass=1 g # x", "chain.mass", "1 g # x", "a mass"),
    ("chain.diameter=2*3 mm", "chain.diameter", "2*3 mm", "a length"),
    ("striker.speed=0 m/s", "striker.speed", "0 m/s", "a speed above zero"),
    ("striker.speed=1e30 m/s", "striker.speed", "1e30 m/s", "from 1e-12 to 10000 m/s"),
    ("striker.shape=cube", "striker.shape", '"cube"', "'sphere' or 'flat'"),
    ("striker.shape=flat", "striker.diameter", "0.00476", 'only with striker.shape = "sphere"'),
    ("materials.ptfe.poisson_ratio=0.5", "materials.ptfe.poisson_ratio", "0.5", "less than 0.5"),
    ("materials.ptfe.poisson_ratio=nan", "materials.ptfe.poisson_ratio", "nan", "finite"),
    ("materials.rigid={youngs_modulus='1 GPa', poisson_ratio=0.3}", "materials.rigid", "this name", "another name"),
    ("chain.material=teflon", "chain.material", '"teflon"', "ptfe"),
    ('chain.material="a; b"', "chain.material", '"a; b"', "letters, digits"),
    ("chain.sensors.0.from_wall=5", "chain.sensors.1.from_wall", "5 twice", "once"),
    ("chain.sensors." + "1" * 5000 + ".mass=1 g", "111", "unknown index", "2 entries, counted from 0"),
    ("chain=3", "chain", "3", "a table"),
    ("run.accuracy=1e-4", "run", "both", "exactly one"),
    ("run.time_step=", "run", "no time_step and no accuracy", "exactly one"),
    ("run.time_step=0.3 us", "run.time_step", "3e-07 s", '"0.333333333333 us"'),
    ("run.time_step=1e-16 s", "run.time_step", "steps", "at most"),
    ("run.duration=0.5 us", "run.duration", "5e-07 s", "sample_interval"),
    ("run.duration=1 year", "run.sample_interval", "samples of 22 contacts", "at most"),
    ("contact={restitution=0.9, damping_ratio=0.1}", "contact", "both", "at most one of the two"),
    ("chain.bead=[{from_wall=2, gap_below='-1 um'}]", "chain.bead.0.gap_below", "-1 um", "zero or more"),
    ("chain.bead=[{from_wall=9, mass='1 g'}]", "chain.sensors.0.mass", "bead 9", "one of the two"),
    ("chain.bead=[{from_wall='9-5', mass='1 g'}]", "chain.bead.0.from_wall", '"9-5"', "a bead such as 5"),
    ("chain.bead=[{from_wall=[3, '2-4'], mass='1 g'}]", "chain.bead.0.from_wall", "3 twice", ""),
    ("chain.bead=[{from_wall='20-30', mass='1 g'}]", "chain.bead.0.from_wall", "22", "1 to 21"),
    ("chain.bead=[{from_wall=1}, {from_wall='2-8', mass='1 m'}]", "chain.bead.1.mass", '"1 m"', ""),
    ("chain.bead=[{from_wall='1-999999999', mass='1 g'}]", "chain.bead.0.from_wall", '"1-999999999"', ""),
    (f"chain.pattern=[{'{}, ' * 22}]", "chain.pattern", "22 members", "1 to 21"),
    ("chain.taper=0.1", "chain.taper", "", "a ratio closer to 1, or fewer beads"),
    ("chain={count=9,material='ptfe',diameter='2 mm',taper=0.9,taper_to='1 mm'}", "", "both taper and taper_to", ""),
    ("chain.angle=91 deg", "chain.angle", "91 deg", "0, or from 1e-09 to 90 deg"),
    ("chain.count.x=1", "chain.count.x", "unknown key", "only tables and lists have keys"),
    ("chain.count=" + "1" * 5000, "chain.count", "111", "a valid integer"),
    ("chain.count=0x" + "f" * 5000, "chain.count", "thousands of digits", "less than or equal to"),
    ("chain.count=5\nx=2", "chain.count", "5", "a valid integer"),
    ("nonsense", "", "not of the form KEY=VALUE", "chain.count=60"),
    ("chain.mass=1e-24 kg", "chain.mass", "1e-24 kg of body 1", "at least 5.6e-12 kg"),
]

# the same for scenes in a tube, with the scene first
BAD_IN_TUBES = [
    ("fig4-tube", "tube.inner_diameter=4.76 mm", "tube.inner_diameter", "0.00476 m", "more than"),
    ("fig4-tube", "tube.inner_diameter=9.6 mm", "tube.inner_diameter", "0.0096 m", "stay in line"),
    ("fig6d-tube", "tube.top=", "tube.top", "missing key", "wider than the bore"),
    ("fig6d-tube", "tube.top=45 mm", "tube.top", "0.045 m", "at most 0.0431"),
    ("fig5-tube", "tube.top=53 mm", "tube.top", "0.053 m", "at most 0.05236 m"),
    ("fig4-tube", "tube=", "chain.lateral_offset", "3e-05 m without a tube", "a [tube]"),
    ("fig4-tube", "chain.lateral_offset=121 um", "chain.lateral_offset", "0.000121 m", "the play of 0.00012 m"),
    ("fig4-tube", "chain.angle=10 deg", "chain.angle", "10 deg", ""),
    ("fig4-tube", "run={duration='1 ms', sample_interval='1 us', accuracy=1e-3}", "run.accuracy", "sideways", "ste"),
]


def message_of(scene: str, *settings: str) -> str:
    """Message by which a scene is refused."""
    with pytest.raises(InputError) as refused:
        build_case(read_scene(scene, settings))
    return str(refused.value)


@pytest.mark.parametrize(
    ("scene", "setting", "key", "found", "allowed"),
    [*(("fig4", *row) for row in BAD), *BAD_IN_TUBES],
    ids=[row[0][:40] for row in BAD] + [f"{row[0]} {row[1][:40]}" for row in BAD_IN_TUBES],
)
def test_message_names_the_bad_key(scene: str, setting: str, key: str, found: str, allowed: str) -> None:
    message = message_of(scene, setting)
    assert f"{scene}.toml" in message or "--set" in message
    assert_in_order(message, key, found, allowed)


def test_lateral_offset_may_be_as_large_as_the_play() -> None:
    for diameter, offset in (("5 mm", "120 um"), ("4.760002 mm", "1 nm"), ("4.7606 mm", "0.3 um")):
        build_case(
            read_scene("fig4-tube", ("wall=", f"tube.inner_diameter={diameter}", f"chain.lateral_offset={offset}"))
        )


def test_engine_refuses_a_tube_that_it_cannot_model() -> None:
    fast, coarse = "chain.bead=[{from_wall=3, lateral_velocity='2 km/s'}]", "run.time_step=20 us"
    lacks = (
        "lateral freedom, tube, friction, rotation; allowed: an engine that models it: lammps, liggghts, verlet, yade"
    )
    for engine, settings, message in (
        ("reference", (), lacks),
        ("yade", (coarse, "run.sample_interval=20 us"), "run.time_step: found 2e-05 s; allowed: at mo"),
        ("verlet", (fast,), "radii deep into the bore; allowed: ov"),
    ):
        with pytest.raises(InputError) as refused:
            refuse(build_case(read_scene("fig4-tube", settings)), engine)
        assert_in_order(str(refused.value), message)


def test_a_free_chain_may_fly_past_the_place_of_a_wall() -> None:
    free = ("wall=", "gravity=", "chain.count=5", "chain.sensors=[]", "run.duration=10 ms")
    refuse(build_case(read_scene("table1", free)), "verlet")


@pytest.mark.parametrize("setting", ["chain.mass=6e-12 kg", "striker.diameter=1e-9 m"])
def test_scene_that_needs_a_billion_steps_is_refused_within_seconds(setting: str) -> None:
    coarse = read_scene("fig4", ("run.sample_interval=10 us", "run.time_step=10 us"))
    refuse(build_case(coarse), "verlet")  # compiles the integrators
    case = build_case(read_scene("fig4", (setting,)))
    began = time.process_time()
    with pytest.raises(InputError, match=r"a trial gains|radii deep"):
        refuse(case, "verlet")
    assert time.process_time() - began < 3, "about 0.2 s; 16 s if the whole motion is integrated"


def test_long_texts_are_refused_within_seconds(scene_file: SceneWriter, tmp_path: Path) -> None:
    began, long = time.process_time(), 100_000
    for text in (f"[{'a.' * long}a]", f"{'a . ' * long}a = 1", f"[materials{'.a' * long}]"):
        with pytest.raises(InputError, match="not valid TOML: a key of a hundred parts"):
            read_scene(scene_file(top=text))
    for text in ("9" * long, f"1 m{' ' * long}%", f"1 {'m' * long}"):
        with pytest.raises(InputError, match=r"striker.speed: found .*; allowed: a speed"):
            read_scene("fig4", (f"striker.speed={text}",))
    assert time.process_time() - began < 5, "about 0.5 s; 20 s or more for each of them without its limit"


def test_short_parts_of_a_message_are_kept_whole() -> None:
    message = str(InputError("a" * 4000, "chain.mass", "1 mm", "a mass"))
    assert len(message) <= 270
    assert message.endswith("chain.mass: found 1 mm; allowed: a mass")


def test_all_problems_of_a_scene_are_listed_on_one_line() -> None:
    hard = "materials.hard={young_modulus='70 GPa', poisson_ratio=0.22}"
    assert_in_order(
        message_of("fig4", hard, "chain.coutn=3", "striker.speed=0 m/s"),
        ": 4 problems: (1) chain.coutn: unknown key; did you mean count?",
        " (2) materials.hard.youngs_modulus: missing key",
        " (3) materials.hard.young_modulus: unknown key; did you mean youngs_modulus?",
        ' (4) striker.speed: found "0 m/s"; allowed: a speed above zero',
    )
    assert_in_order(
        message_of("fig4", "chain.sensors.0.from_wall=22", "striker.diameter=", "run.record=['state']"),
        "3 problems: (1) run.record",
        "(2) chain.sensors.0.from_wall: found 22; allowed: 1 to 21",
        "(3) striker.diameter: missing",
    )
    entries = ", ".join("{from_wall='%s'}" % ("x" * 300) for _ in range(100))
    message = message_of("fig4", f"chain.bead=[{entries}]")
    assert_in_order(message, "100 problems: (1) chain.bead.0.from_wall", "(12) ", " and 88 more")
    assert len(message) < 4000


def test_step_that_a_message_suggests_is_accepted() -> None:
    suggested = message_of("fig4", "run.time_step=0.3 us").rsplit('"', 2)[1]
    assert read_scene("fig4", (f"run.time_step={suggested}",)).steps_per_sample == 3


def test_file_that_is_no_scene_is_refused_by_name(scene_file: SceneWriter, tmp_path: Path) -> None:
    texts = [text.encode() for text in ("", "gravity = ", "[chain]\ncount = 1\n[chain]\n", '"\x00"')]
    for content, words in (*((text, "") for text in texts), (b'title = "\xe9"', r"byte 0xe9 at 9; allowed: UTF-8")):
        (tmp_path / "wrong.toml").write_bytes(content)
        with pytest.raises(InputError, match=rf"wrong\.toml.*{words}"):
            read_scene(tmp_path / "wrong.toml")
    (tmp_path / "folder.toml").mkdir()
    for name, words in (("folder", "a folder"), ("absent", "file not found")):
        with pytest.raises(InputError, match=words):
            read_scene(tmp_path / f"{name}.toml")
    for name in (".toml", "..toml", "a b.toml", "-rf.toml", "a;b.toml", "ä.toml", "scene.txt", "a" * 101 + ".toml"):
        scene_file().rename(tmp_path / name)
        with pytest.raises(InputError, match="scene"):
            read_scene(tmp_path / name)
    for name in ("../../etc/passwd", "nosuch", "..", "fig4/../fig4", "inputs"):
        with pytest.raises(InputError):
            read_scene(name)


RENDER = ("render", "fig4", "--engine", "verlet", "--out")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("run", "fig4", "--runs", "/proc/x"), "'--runs': found /proc/x"),
        ((*RENDER, "/dev/null"), "(Not a directory); allowed: a folder"),
        ((*RENDER, "{tmp}/deck", "--set", "a="), "a: unknown key"),
        (("run", "n" * 4000), "File name too long"),
        (("run", "fig4", "--engine", "n" * 4000), "liggghts"),
        (("run", "fig4", "--set", f"{'n' * 4000}=1"), "unknown key"),
    ],
)
def test_bad_command_ends_with_code_two_and_one_line(tmp_path: Path, words: tuple[str, ...], message: str) -> None:
    filled = [word.replace("{tmp}", str(tmp_path)) for word in words]
    runs = ["--runs", str(tmp_path / "runs")] if words[0] == "run" and len(words) > 1 and "--runs" not in words else []
    done = beads(*filled, *runs)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert len(done.stderr) <= 300
    assert message in done.stderr
    assert not list(tmp_path.iterdir()), "bad commands write no files"


def test_control_characters_do_not_reach_the_terminal(scene_file: SceneWriter, tmp_path: Path) -> None:
    """Titles, names of files, and folders on standard output."""
    signs = ("\x1b[31m", "\x9b31m", "\u202e", "\u2066", "\x00", "\r")
    title = "".join(f"\\u{ord(letter):04x}" for letter in "".join(signs))
    titled, odd = scene_file("titled", top=f'title = "fine{title}"'), "odd" + "".join(signs).replace("\0", "")
    refused = [beads(name, titled) for name in ("plan", "run", "compare", "draw")]
    refused += [beads("plan", f"{tmp_path}/{odd}.toml")]
    assert {(ended.returncode, ended.stderr.count("\n")) for ended in refused} == {(2, 1)}
    plain, runs = scene_file("plain", duration="20 us"), ("--runs", tmp_path / odd)
    done = [beads("run", plain, "--engine", "verlet", *runs), beads("runs", *runs)]
    assert {ended.returncode for ended in done} == {0}
    for ended in (*refused, *done):
        assert not CONTROL.search(ended.stdout + ended.stderr)
        assert "\r" not in ended.stdout + ended.stderr
