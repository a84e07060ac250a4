"""Bad input ends with one line that names the file, the key, the value found and the values allowed."""

import time
from pathlib import Path
from random import Random

import pytest

from drivers.base.errors import CONTROL, InputError
from drivers.chain.case import build_case
from drivers.limits.refusal import refuse
from drivers.scene.read_scene import read_scene
from validation.tests.helpers.commands import assert_in_order, beads
from validation.tests.helpers.scenes import SceneWriter

# setting of fig4, and parts of the message in order: key, value found, values allowed
BAD = [
    ("chain.coutn=3", "chain.coutn", "unknown key", "did you mean count?"),
    ("grvity=1", "grvity", "unknown key", "gravity"),
    ("chain.sensors.0.mas=1", "chain.sensors.0.mas", "unknown key", "mass"),
    ("materials.ptfe.colour=1", "materials.ptfe.colour", "unknown key", "density"),
    ("chain.count=", "chain.count", "missing key", ""),
    ("run.duration=", "run.duration", "missing key", ""),
    ("chain.count=2.5", "chain.count", "2.5", "whole number"),
    ("chain.count=-1", "chain.count", "-1", "0 or more"),
    ("chain.count=true", "chain.count", "True", "whole number"),
    ('chain.count="21"', "chain.count", '"21"', "whole number"),
    ("chain.count=1000000000000", "chain.count", "1000000000000", "at most"),
    ("chain.mass=2 mm", "chain.mass", "2 mm", "a mass above zero"),
    ("chain.mass=0.1226", "chain.mass", "0.1226", 'with its unit, such as "0.1226 g"'),
    ("chain.mass=-1 g", "chain.mass", "-1 g", "above zero"),
    ("chain.mass=0 g", "chain.mass", "0 g", "above zero"),
    ("chain.mass=nan g", "chain.mass", "nan g", "a mass"),
    ("chain.mass=inf g", "chain.mass", "inf g", "a mass"),
    ("chain.mass=1e400 g", "chain.mass", "1e400 g", "from 1e-24"),
    ("chain.mass=1e-400 g", "chain.mass", "1e-400 g", "from 1e-24"),
    ("chain.diameter=4.76", "chain.diameter", "4.76", "a length"),
    ("chain.diameter=2*3 mm", "chain.diameter", "2*3 mm", "a length"),
    ("gravity=-9.81 m/s^2", "gravity", "-9.81 m/s^2", "zero or more"),
    ("gravity=9.81", "gravity", "9.81", "an acceleration"),
    ("striker.speed=0 m/s", "striker.speed", "0 m/s", "a speed above zero"),
    ("striker.shape=cube", "striker.shape", '"cube"', "'sphere' or 'flat'"),
    ("materials.ptfe.poisson_ratio=0.5", "materials.ptfe.poisson_ratio", "0.5", "below 0.5"),
    ("materials.ptfe.poisson_ratio=-0.1", "materials.ptfe.poisson_ratio", "-0.1", "0 or more"),
    ("materials.ptfe.poisson_ratio=nan", "materials.ptfe.poisson_ratio", "nan", "finite"),
    ("materials.ptfe.youngs_modulus=0 Pa", "materials.ptfe.youngs_modulus", "0 Pa", "above zero"),
    ("chain.material=teflon", "chain.material", '"teflon"', "ptfe"),
    ("wall.material=cheese", "wall.material", '"cheese"', "rigid"),
    ("chain.material=rigid", "chain.material", '"rigid"', "brass"),
    ('chain.material="a; b"', "chain.material", '"a; b"', "letters, digits"),
    ("chain.sensors.0.from_wall=22", "chain.sensors.0.from_wall", "22", "1 to 21"),
    ("chain.sensors.0.from_wall=0", "chain.sensors.0.from_wall", "0", "1 or more"),
    ("chain.sensors.0.from_wall=5", "chain.sensors.1.from_wall", "5 twice", "once"),
    ("chain.sensors=3", "chain.sensors", "3", "a list"),
    ("chain=3", "chain", "3", "a table"),
    ("run.accuracy=1e-4", "run", "both", "exactly one"),
    ("run.time_step=", "run", "no time_step and no accuracy", "exactly one"),
    ("run.time_step=0.3 us", "run.time_step", "3e-07 s", '"0.333333333333 us"'),
    ("run.time_step=2 us", "run.time_step", "2e-06 s", '"1 us"'),
    ("run.duration=0.5 us", "run.duration", "5e-07 s", "sample_interval"),
    ("run.duration=1 year", "run.sample_interval", "samples of 22 contacts", "at most"),
    ("run.record=['state']", "run.record", "state", "forces"),
    ("materials.rigid={youngs_modulus='1 GPa', poisson_ratio=0.3}", "materials.rigid", "this name", "another name"),
    ("run.time_step=1e-16 s", "run.time_step", "steps", "at most"),
    ("contact.restitution=0.0", "contact.restitution", "0", "0.0001"),
    ("contact.restitution=1.1", "contact.restitution", "1.1", "1"),
    ("contact.damping_ratio=-0.1", "contact.damping_ratio", "-0.1", "0 or more"),
    ("contact={restitution=0.9, damping_ratio=0.1}", "contact", "both", "one of the two"),
    ("contact.friction=-1", "contact.friction", "-1", "0 or more"),
    ("sensor.time_constant=0 ms", "sensor.time_constant", "0 ms", "a time above zero"),
    ("sensor.time_constant=-1 ms", "sensor.time_constant", "-1 ms", "a time above zero"),
    ("sensor.time_constant=1e-3", "sensor.time_constant", "0.001", 'with its unit, such as "0.8 ms"'),
    ("sensor.time_constant=1 kHz", "sensor.time_constant", "1 kHz", "a time above zero"),
    ("sensor.time_constant=inf s", "sensor.time_constant", "inf s", "a time above zero"),
    ("sensor={}", "sensor.time_constant", "missing key", ""),
    ("sensor={time_constant='1 ms', gain=2}", "sensor.gain", "unknown key", "time_constant"),
    ("tube.inner_diameter=4 mm", "tube.inner_diameter", "0.004 m", "0.00476 m"),
    ("striker.shape=flat", "striker.diameter", "0.00476 m", "no diameter"),
    ("striker.diameter=", "striker.diameter", "missing key", "diameter"),
    ("chain.bead=[{from_wall=2, gap_below='-1 um'}]", "chain.bead.0.gap_below", "-1 um", "zero or more"),
    ("chain.bead=[{from_wall=9, mass='1 g'}]", "chain.sensors.0.mass", "bead 9", "one of the two"),
    ("title=3", "title", "3", "text"),
    ("chain.sensors.7.mass=1 g", "chain.sensors.7.mass", "unknown index", "2 entries, counted from 0"),
    ("chain.count.x=1", "chain.count.x", "unknown key", "only tables and lists have keys"),
    ("chain.mass=٣ g", "chain.mass", "٣ g", "a mass"),
    ("chain.mass=1 g # x", "chain.mass", "1 g # x", "a mass"),
    ("chain.mass=1e40 kg", "chain.mass", "1e40 kg", "1e-24 to 1e+12 kg"),
    ("chain.count=" + "1" * 5000, "chain.count", "111", "a whole number"),
    ("chain.count=0x" + "f" * 5000, "chain.count", "thousands of digits", "at most"),
    ("chain.count=" + "[" * 5000, "chain.count", "[[[", "a whole number"),
    ("chain.count=5\nx=2", "chain.count", "5", "a whole number"),
    ("float=3", "float", "unknown key", "chain"),
    ("run.accuracy=true", "run.accuracy", "True", ""),
    ("chain.sensors." + "1" * 5000 + ".mass=1 g", "111", "unknown index", "2 entries, counted from 0"),
    ("nonsense", "", "not of the form KEY=VALUE", "chain.count=60"),
    ("a=", "a", "unknown key", "chain"),
    ("chain.coutn=", "chain.coutn", "unknown key", "did you mean count?"),
    ("chain.sensors.0.colour=", "chain.sensors.0.colour", "unknown key", "mass"),
    ("chain.mass=1e-30 kg", "chain.mass", "1e-30 kg", "from 1e-24 to 1e+12 kg"),
    ("striker.speed=1e30 m/s", "striker.speed", "1e30 m/s", "from 1e-12 to 10000 m/s"),
    ("materials.ptfe.youngs_modulus=1e30 Pa", "youngs_modulus", "1e30 Pa", "from 1 to 1e+14 Pa"),
    ("materials.ptfe.density=1e9 kg/m^3", "density", "1e9 kg/m^3", "from 0.001 to 1e+06 kg/m^3"),
    ("gravity=1e20 m/s^2", "gravity", "1e20 m/s^2", "0, or from 1e-30 to 1e+07 m/s^2"),
    ("chain.bead=[{from_wall=2, velocity='-1e9 m/s'}]", "chain.bead.0.velocity", "-1e9 m/s", "from -10000 to 10000"),
    ("contact.friction=1e30", "contact.friction", "1e+30", "at most 100"),
]


# the same for scenes in a tube, with the scene first
BAD_IN_TUBES = [
    ("fig4-tube", "tube.inner_diameter=4.76 mm", "tube.inner_diameter", "0.00476 m", "more than"),
    ("fig4-tube", "tube.inner_diameter=4.5 mm", "tube.inner_diameter", "0.0045 m", "0.00476 m"),
    ("fig4-tube", "chain.bead=[{from_wall=3, diameter='5 mm'}]", "tube.inner_diameter", "0.005 m", "more than"),
    ("fig4-tube", "tube.inner_diameter=9.6 mm", "tube.inner_diameter", "0.0096 m", "stay in line"),
    ("fig4-tube", "chain.bead=[{from_wall=3, diameter='1 mm'}]", "tube.inner_diameter", "0.005 m", "stay in line"),
    ("fig4-tube", "striker.diameter=0.1 mm", "tube.inner_diameter", "0.005 m", "stay in line"),
    ("fig6d-tube", "tube.top=", "tube.top", "missing key", "wider than the bore"),
    ("fig6d-tube", "tube.top=45 mm", "tube.top", "0.045 m", "at most 0.0431"),
    ("fig6d-tube", "tube.top=30 mm", "tube.top", "0.03 m", "the height of the top bead"),
    ("fig5-tube", "tube.top=", "tube.top", "missing key", "wider than the bore"),
    ("fig5-tube", "tube.top=53 mm", "tube.top", "0.053 m", "at most 0.05236 m"),
    ("fig5-tube", "tube.top=20 mm", "tube.top", "0.02 m", "at least 0.0499"),
    ("fig5-tube", "tube.top=1 um", "tube.top", "1e-06 m", "at least 0.0499"),
    ("fig4-tube", "tube=", "chain.lateral_offset", "3e-05 m without a tube", "a [tube]"),
    ("fig4-tube", "chain.lateral_offset=121 um", "chain.lateral_offset", "0.000121 m", "the play of 0.00012 m"),
    ("fig4-tube", "chain.lateral_offset=1 km", "chain.lateral_offset", "1000 m", "the play of 0.00012 m"),
    ("fig4-tube", "chain.lateral_offset=-1 um", "chain.lateral_offset", "-1 um", "zero or more"),
    ("fig4-tube", "chain.lateral_offset=30", "chain.lateral_offset", "30", "with its unit"),
    ("fig4-tube", "contact.friction=-0.1", "contact.friction", "-0.1", "0 or more"),
    ("fig4-tube", "tube.friction=-0.1", "tube.friction", "-0.1", "0 or more"),
    ("fig4-tube", "tube.friction=nan", "tube.friction", "nan", "finite"),
    ("fig4-tube", "tube.material=rigid", "tube.material", '"rigid"', "ptfe"),
    (
        "fig4-tube",
        "run={duration='1 ms', sample_interval='1 us', accuracy=1e-3}",
        "run.accuracy",
        "move sideways",
        "ste",
    ),
    ("fig4-tube", "chain.bead=[{from_wall=3, lateral_velocity=5}]", "lateral_velocity", "5", "a velocity"),
    (
        "fig4-tube",
        "chain.bead=[{from_wall=3, lateral_velocity='nan m/s'}]",
        "lateral_velocity",
        "nan m/s",
        "a velocity",
    ),
    (
        "fig4-tube",
        "chain={count=0, material='ptfe', diameter='4.76 mm', lateral_offset='0 um'}",
        "chain.count",
        "0",
        "1",
    ),
    ("fig4-tube", "contact.rotation=2", "contact.rotation", "2", "true or false"),
]


@pytest.mark.parametrize(("scene", "setting", "key", "found", "allowed"), BAD_IN_TUBES)
def test_messages_name_bad_keys_of_a_tube(scene: str, setting: str, key: str, found: str, allowed: str) -> None:
    with pytest.raises(InputError) as caught:
        build_case(read_scene(scene, (setting,)))
    assert_in_order(str(caught.value), key, found, allowed)


def test_a_lateral_offset_may_be_as_large_as_the_play() -> None:
    for diameter, offset in (("5 mm", "120 um"), ("4.760002 mm", "1 nm"), ("4.7606 mm", "0.3 um")):
        read_scene("fig4-tube", (f"tube.inner_diameter={diameter}", f"chain.lateral_offset={offset}"))


@pytest.mark.parametrize(
    ("engine", "settings", "message"),
    [
        (
            "reference",
            (),
            "lateral freedom, tube, friction, rotation; allowed: an engine that models it: liggghts, verlet",
        ),
        (
            "yade",
            ("run.sample_interval=20 us", "run.time_step=20 us"),
            "run.time_step: found 2e-05 s; allowed: at most 1",
        ),
        ("yade", ("striker.speed=5 km/s",), "radii deep; allowed: overlaps below a radius"),
        (
            "verlet",
            ("chain.bead=[{from_wall=3, lateral_velocity='2 km/s'}]",),
            "radii deep into the bore; allowed: over",
        ),
    ],
)
def test_engines_refuse_tubes_that_they_cannot_model(engine: str, settings: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError) as caught:
        refuse(build_case(read_scene("fig4-tube", settings)), engine)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("setting", "key", "found", "allowed"), BAD, ids=[bad[0][:40] for bad in BAD])
def test_messages_name_bad_keys(setting: str, key: str, found: str, allowed: str) -> None:
    with pytest.raises(InputError) as caught:
        read_scene("fig4", (setting,))
    assert_in_order(str(caught.value), key, found, allowed)


@pytest.mark.parametrize(
    ("setting", "key"),
    [
        ("chain.mass_scatter=1 g", "chain.mass_scatter"),
        ("chain.precompression=100 kN", "chain.precompression"),
        ("gravity=1e9 m/s^2", "gravity"),
    ],
)
def test_chains_without_equilibrium_are_refused(setting: str, key: str) -> None:
    with pytest.raises(InputError, match=key):
        build_case(read_scene("fig4", (setting,)))


@pytest.mark.parametrize(
    "setting", ["chain.mass=1e-24 kg", "chain.bead=[{from_wall=3, mass='1e-15 kg'}]", "striker.diameter=1e-9 m"]
)
def test_scenes_that_need_a_billion_steps_are_refused_within_seconds(setting: str) -> None:
    coarse = read_scene("fig4", ("run.sample_interval=10 us", "run.time_step=10 us"))
    refuse(build_case(coarse), "verlet")  # compiles the integrators
    case = build_case(read_scene("fig4", (setting,)))
    began = time.process_time()
    with pytest.raises(InputError, match=r"unstable at|radii deep"):
        refuse(case, "verlet")
    assert time.process_time() - began < 3, "about 0.2 s; 16 s if the whole motion is integrated"


def test_messages_are_one_short_line() -> None:
    """Messages stay short and printable for parts of any length and content; short parts are kept whole."""
    random = Random(17)
    for _ in range(300):
        where, key, found, allowed = (
            "".join(random.choices("ab /.\n\x1b\u2028", k=int(10 ** random.uniform(0, 5)))) for _ in range(4)
        )
        message = str(InputError(where, key, found, allowed))
        assert len(message) <= 270
        assert len(message.splitlines()) == 1
        assert message.isprintable()
        assert "found " in message
    assert str(InputError("a" * 4000, "chain.mass", "1 mm", "a mass")).endswith(
        "chain.mass: found 1 mm; allowed: a mass"
    )


def test_all_problems_of_a_scene_are_listed_on_one_line(scene_file: SceneWriter) -> None:
    settings = ("materials.hard={young_modulus='70 GPa', poisson_ratio=0.22}", "chain.coutn=3", "striker.speed=0 m/s")
    with pytest.raises(InputError) as caught:
        read_scene("fig4", settings)
    assert_in_order(
        str(caught.value),
        ": 3 problems: (1) chain.coutn: unknown key; did you mean count?",
        " (2) materials.hard: missing key youngs_modulus; unknown key young_modulus",
        ' (3) striker.speed: found "0 m/s"; allowed: a speed above zero',
    )
    with pytest.raises(InputError) as caught:
        read_scene("fig4", ("materials.rigid={youngs_modulus='1 GPa', poisson_ratio=0.3}", "wall.material=cheese"))
    assert_in_order(str(caught.value), "2 problems: (1) materials.rigid", "(2) wall.material: found", "brass")
    with pytest.raises(InputError) as caught:
        read_scene("fig4", ("chain.sensors.0.from_wall=22", "striker.diameter=", "run.record=['state']"))
    assert_in_order(
        str(caught.value), "3 problems: (1) run.record", "(2) chain.sensors.0", "(3) striker.diameter: missing"
    )


def test_a_hundred_problems_stay_on_one_line() -> None:
    entries = ", ".join("{from_wall='%s'}" % ("x" * 300) for _ in range(100))
    with pytest.raises(InputError) as caught:
        read_scene("fig4", (f"chain.bead=[{entries}]",))
    assert_in_order(str(caught.value), "100 problems: (1) chain.bead.0.from_wall", "(12) ", " and 88 more")
    assert len(str(caught.value)) < 4000


def test_the_step_that_a_message_suggests_is_accepted() -> None:
    with pytest.raises(InputError) as caught:
        read_scene("fig4", ("run.time_step=0.3 us",))
    named = str(caught.value).rsplit('"', 2)[1]
    scene = read_scene("fig4", (f"run.time_step={named}",))
    assert scene.steps_per_sample == 3


@pytest.mark.parametrize("text", ["", "gravity = ", "[chain]\ncount = 1\n[chain]\n", '"\x00"'])
def test_texts_that_are_no_scene_are_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"scene\.toml"):
        read_scene(path)


@pytest.mark.parametrize(
    "name", [".toml", "..toml", "a b.toml", "-rf.toml", "a;b.toml", "ä.toml", "scene.txt", "a" * 101 + ".toml"]
)
def test_unsafe_file_names_are_refused(tmp_path: Path, scene_file: SceneWriter, name: str) -> None:
    scene_file().rename(tmp_path / name)
    with pytest.raises(InputError, match="scene"):
        read_scene(tmp_path / name)


@pytest.mark.parametrize("name", ["../../etc/passwd", "nosuch", "..", "fig4/../fig4", "inputs"])
def test_unknown_scenes_are_refused(name: str) -> None:
    with pytest.raises(InputError):
        read_scene(name)


def test_messages_for_unreadable_files(tmp_path: Path) -> None:
    (tmp_path / "latin.toml").write_bytes(b'title = "\xe9"')
    with pytest.raises(InputError, match=r"byte 0xe9 at 9; allowed: UTF-8"):
        read_scene(tmp_path / "latin.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(InputError, match="directory"):
        read_scene(tmp_path / "folder.toml")
    with pytest.raises(InputError, match="file not found"):
        read_scene(tmp_path / "absent.toml")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("run", "fig4", "--set", "chain.mass=2 mm"), "chain.mass"),
        (("run", "fig4", "--engine", "abaqus"), "liggghts"),
        (("render", "fig4", "--engine", "yade", "--out", "{tmp}/deck", "--set", "x=1"), "x"),
        (("run", "fig4", "--time-limit", "-1"), "--time-limit"),
        (("run", "fig4-tube", "--set", "tube.inner_diameter=4.76 mm"), "tube.inner_diameter"),
        (("run", "fig6d-tube", "--set", "tube.top="), "tube.top"),
        (("run", "fig4-tube", "--engine", "reference"), "lateral freedom"),
        (
            ("run", "fig4-tube", "--set", "tube.inner_diameter=4.760002 mm", "--set", "chain.lateral_offset=1 nm"),
            "no equilibrium: ",
        ),
        (("run",), "SCENE"),
        (("walk",), "no such command 'walk'"),
        (("run", "fig4", "--runs", "/proc/x"), "--runs /proc/x"),
        (("render", "fig4", "--engine", "verlet", "--out", "/sys/x/y"), "--out /sys/x/y"),
        (("render", "fig4", "--engine", "verlet", "--out", "/dev/null"), "no folder"),
        (("render", "fig4", "--engine", "verlet", "--out", "{tmp}/" + "n" * 4000), "File name too long"),
        (("run", "n" * 4000), "File name too long"),
        (("run", "fig4", "--engine", "n" * 4000), "liggghts"),
        (("run", "fig4", "--set", f"{'n' * 4000}=1"), "unknown key"),
        (("n" * 4000,), "no such command"),
        (("render", "fig4", "--engine", "verlet", "--out", "{tmp}/deck", "--set", "a="), "a: unknown key"),
    ],
)
def test_bad_commands_end_with_code_two_and_one_line(tmp_path: Path, words: tuple[str, ...], message: str) -> None:
    filled = [word.replace("{tmp}", str(tmp_path)) for word in words]
    runs = ["--runs", str(tmp_path / "runs")] if words[0] == "run" and len(words) > 1 and "--runs" not in words else []
    done = beads(*filled, *runs)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert len(done.stderr) <= 300
    assert message in done.stderr
    assert not list(tmp_path.iterdir()), "bad commands write no files"


@pytest.mark.parametrize("sign", ["\x1b[31m", "\x9b31m", "\u202e", "\u2066", "\x00", "\r"])
def test_control_characters_do_not_reach_the_terminal(sign: str, scene_file: SceneWriter, tmp_path: Path) -> None:
    """Titles, names of files, and folders on standard output."""
    code = "".join(f"\\u{ord(letter):04x}" for letter in sign)
    titled = scene_file("titled", top=f'title = "fine{code}"')
    plain = scene_file("plain", duration="20 us")
    runs = tmp_path / f"runs{sign.replace(chr(0), '')}"
    commands: list[tuple[str | Path, ...]] = [(name, titled) for name in ("plan", "run", "compare", "draw")]
    commands += [("plan", f"{tmp_path}/odd{sign.replace(chr(0), '')}.toml")]
    refused = [beads(*words) for words in commands]
    assert {ended.returncode for ended in refused} == {2}
    assert {ended.stderr.count("\n") for ended in refused} == {1}
    done = [beads(*words, "--runs", runs) for words in (("run", plain, "--engine", "verlet"), ("runs",))]
    assert {ended.returncode for ended in done} == {0}
    for ended in (*refused, *done):
        assert not CONTROL.search(ended.stdout + ended.stderr)
        assert "\r" not in ended.stdout + ended.stderr
