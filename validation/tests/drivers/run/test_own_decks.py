"""Decks of one's own: written by hand for LAMMPS and LIGGGHTS, imported with nothing renamed and judged."""

import re
import shutil
import subprocess
from pathlib import Path
from typing import NamedTuple

import pytest

from drivers.run.run_folder import open_run, record_of
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import SceneWriter

STRIKER = '[striker]\nmaterial = "ptfe"\ndiameter = "4.76 mm"\nmass = "0.1226 g"\nspeed = "1 m/s"\n'
PROGRAMS = {"lammps": "lmp", "liggghts": "liggghts"}
HEIGHTS = [f"{0.00238 + 0.00476 * place:.5f}" for place in range(6)]
SCENES = {"wall": {}, "free": {"wall": ""}, "gravity": {"top": 'gravity = "9.81 m/s^2"'}}
LIGGGHTS = f"""units si
atom_style granular
atom_modify map array
boundary m m m
newton off
communicate single vel yes
region box block -0.01 0.01 -0.01 0.01 0 0.04 units box
create_box 2 box
hard_particles yes
{"".join(f"create_atoms 1 single 0 0 {height} units box" + chr(10) for height in HEIGHTS)}
set group all diameter 0.00476 density 2171.0558198513872
group striker id 6
velocity striker set 0 0 -1 units box
neighbor 0.001 bin
fix m1 all property/global youngsModulus peratomtype 1.46e9 115e9
fix m2 all property/global poissonsRatio peratomtype 0.46 0.307
fix m3 all property/global coefficientRestitution peratomtypepair 2 1 1 1 1
fix m4 all property/global coefficientFriction peratomtypepair 2 0 0 0 0
pair_style gran model hertz tangential no_history
pair_coeff * *
fix w all wall/gran model hertz tangential no_history primitive type 2 zplane 0.0
fix i all nve/sphere
timestep 1e-7
dump d all custom 10 post.txt id type x y z vx vy vz fx fy fz
run 3000
"""
LAMMPS = f"""units si
atom_style sphere
atom_modify map array
boundary f f f
newton off
comm_modify vel yes
region box block -0.01 0.01 -0.01 0.01 -0.001 0.04
create_box 1 box
{"".join(f"create_atoms 1 single 0 0 {height}" + chr(10) for height in HEIGHTS)}
set group all diameter 0.00476
set group all density 2171.0558198513872
group striker id 6
velocity striker set 0 0 -1
neighbor 0.001 bin
pair_style granular
pair_coeff * * hertz 1234567901.2345679 0 tangential linear_nohistory 0 0 damping velocity
fix w all wall/gran granular hertz 2433640277.271408 0 tangential linear_nohistory 0 0 damping velocity zplane 0 NULL
fix i all nve/sphere
timestep 1e-7
dump d all custom 10 post.txt id type x y z vx vy vz fx fy fz
run 3000
"""
ALL = "dump d all custom 10 post.txt id type x y z vx vy vz fx fy fz"
EXACT, SOFT = r"to \d\.\de-1[0-9] of", r"to \d\.\de-0[678] of"


class Own(NamedTuple):
    """A deck of one's own.

    Attributes:
        changes: patterns in the plain deck, and their replacements.
        dump: its output, and further words of the command.
        agrees: pattern of the verdict on it.
        fault: pattern in the deck and its replacement that make it wrong.
        named: the diagnosis of that.
    """

    engine: str
    changes: tuple[tuple[str, str], ...]
    dump: tuple[str, ...]
    agrees: str
    fault: tuple[str, str]
    named: str
    scene: str = "wall"


PRESSED = (  # heights under the weight of the beads
    "0.002379863104319186", "0.007139629424788695", "0.011899436526586387", "0.016659289317706688",
    "0.021419196581923556", "0.026179196581923556",
)  # fmt: skip
AT_REST = tuple((f" {height} units", f" {lower} units") for height, lower in zip(HEIGHTS, PRESSED, strict=True))
MODULUS = ("1.46e9", "1.4746e9")
STIFFER = "Young's modulus of ptfe 1.01"
FASTER = ("set 0 0 -1", "set 0 0 -1.02")
HEAVIER = (r"(group striker id 6\n)", r"\1set atom 3 density 2280\n")
DIGITS = ("run 3000", 'dump_modify d format "%d %.17g %.17g %.17g"\nrun 3000')
OWN = {
    "liggghts, a text of six digits": Own("liggghts", (), ("post.txt",), SOFT, MODULUS, STIFFER),
    "liggghts, all digits in any order": Own(
        "liggghts", ((ALL, "dump d all custom 10 forces.dump id fz z vz"), DIGITS), ("forces.dump",), EXACT,
        ("1.46e9", "1460014600"), "Young's modulus of ptfe 1.00001",
    ),
    "liggghts, binary": Own(
        "liggghts", ((ALL, "dump d all custom 10 all.bin type id z vz fz radius mass"),),
        ("all.bin", "--columns", "type,id,z,vz,fz,radius,mass"), EXACT, FASTER, "start speeds 1.02 ",
    ),
    "liggghts, forces alone": Own(
        "liggghts", ((ALL, "dump d all custom 10 f.bin id fz"),), ("f.bin", "--columns", "id,fz"), EXACT,
        MODULUS, STIFFER,
    ),
    "liggghts, under gravity": Own(
        "liggghts",
        (("fix i ", "fix g all gravity 9.81 vector 0 0 -1\nfix i "), (ALL, ALL.replace("t.txt", "t/out.*")), *AT_REST),
        ("post/out.*",), SOFT, MODULUS, STIFFER, "gravity",
    ),
    "lammps, a text of six digits": Own("lammps", (), ("post.txt",), SOFT, FASTER, "start speeds 1.02"),
    "lammps, the older pair style": Own(
        "lammps",
        (("pair_style granular", "pair_style gran/hertz/history 1234567901.2345679 NULL 0 NULL 0 0"),
         (r"pair_coeff .*", "pair_coeff * *"),
         (r"granular hertz (\S+) 0 tangential.*velocity", r"hertz/history \1 NULL 0 NULL 0 0"),
         (ALL, "dump d all custom 10 my.bin id z vz fz")),
        ("my.bin",), EXACT, HEAVIER, "bead 3 with 1.05018",
    ),
    "lammps, along x": Own(
        "lammps",
        ((r"single 0 0 (\S+)", r"single \1 0 0"), ("block.*", "block -0.001 0.04 -0.01 0.01 -0.01 0.01"),
         ("zplane", "xplane"), ("set 0 0 -1", "set -1 0 0"), (ALL, "dump d all custom 10 x.bin id x vx fx")),
        ("x.bin", "--columns", "id,z,vz,fz"), EXACT, ("set -1 0 0", "set -1.02 0 0"), "start speeds 1.02 ",
    ),
    "lammps, numbered from the top down": Own(
        "lammps",
        ((r"(?s)create_atoms.*?\n\n", "".join(f"create_atoms 1 single 0 0 {z}\n" for z in HEIGHTS[::-1])),
         ("striker id 6", "striker id 1"), (ALL, "dump d all custom 10 down.bin id z vz fz")),
        ("down.bin",), EXACT, FASTER, "start speeds 1.02 ",
    ),
    "lammps, in free flight": Own(
        "lammps",
        (("fix w .*\n", ""), (ALL, "dump d all custom 10 free.txt vz z fz id"),
         ("run 3000", "dump_modify d format float %.17g\nrun 3000")),
        ("free.txt",), EXACT, ("1234567901.2345679", "1234580246.9135802"), "all contacts 1.00001 times as stiff",
        "free",
    ),
}  # fmt: skip


def imported(own: Own, scene: Path, folder: Path, *further: tuple[str, str]) -> str:
    """Lines of the import of a deck after its changes, run in a folder of its own."""
    (folder / "post").mkdir(parents=True)
    deck = LIGGGHTS if own.engine == "liggghts" else LAMMPS
    for pattern, other in (*own.changes, *further):
        deck, count = re.subn(pattern if pattern != ALL else re.escape(ALL), other, deck)
        assert count, pattern
    (folder / "in.mine").write_text(deck)
    done = subprocess.run(
        (PROGRAMS[own.engine], "-in", "in.mine"), cwd=folder, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout[-300:]
    words: list[str | Path] = ["--scene", scene, "--engine", own.engine, "--runs", folder / "runs", "--dump", *own.dump]
    said = beads("import", folder, *words)
    assert said.returncode == 0, said.stderr
    kept = Path(said.stdout.strip())
    assert (kept / "in.mine").read_text() == deck
    assert record_of(kept).edits[0] == "a deck of one's own: in.mine"  # type: ignore[index]
    assert open_run(kept).trace.force_N.any()
    return said.stderr


QUICK = ("liggghts, a text of six digits", "liggghts, binary", "lammps, along x")


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.long] * (name not in QUICK)) for name in OWN])
def test_a_deck_of_ones_own_is_judged_as_a_rendered_one(name: str, scene_file: SceneWriter, tmp_path: Path) -> None:
    own = OWN[name]
    need(own.engine)
    scene = scene_file(striker=STRIKER, **SCENES[own.scene])
    right = imported(own, scene, tmp_path / "right")
    assert re.search(own.agrees, right), right
    assert "departs" not in right
    wrong = imported(own, scene, tmp_path / "wrong", own.fault)
    assert "departs from its scheme" in wrong
    assert own.named in wrong


PLAIN = OWN["lammps, along x"]._replace(changes=((ALL, "dump d all custom 10 my.bin id z vz fz"),), dump=("my.bin",))
FURTHER = {
    "units in the first frame": ((("run 3000", "dump_modify d units yes time yes\nrun 3000"),), "scheme to", "wall"),
    "gravity": ((("fix i ", "fix g all gravity 9.81 vector 0 0 -1\nfix i "),), "", "wall"),
    "no gravity": (
        tuple((f"0 0 {height}\n", f"0 0 {lower}\n") for height, lower in zip(HEIGHTS, PRESSED, strict=True)),
        "loads 0 times the scene's",
        "gravity",
    ),
    "a higher striker": ((("0.02618", "0.0261805"),), "body 6 starts with a height of 0.0261805 m", "wall"),
    "few digits": (
        (("my.bin", "my.txt"), ("run 3000", "dump_modify d format float %.3g\nrun 3000")),
        "3 digits; 5",
        "",
    ),
    "two columns of one name": ((("my.bin id z vz fz", "my.bin id z vz fz fz"),), "two columns of one name", ""),
}


@pytest.mark.long
@pytest.mark.parametrize("name", FURTHER)
def test_what_a_dump_of_another_deck_tells(name: str, scene_file: SceneWriter, tmp_path: Path) -> None:
    need("lammps")
    changes, said, of = FURTHER[name]
    own = PLAIN._replace(dump=("my.txt",) if name == "few digits" else ("my.bin",))
    scene = scene_file(striker=STRIKER, **SCENES[of or "wall"])
    if of:
        assert said in imported(own, scene, tmp_path / "one", *changes)
    else:
        with pytest.raises(AssertionError, match=said):
            imported(own, scene, tmp_path / "one", *changes)


def test_a_dump_without_its_deck_is_judged(scene_file: SceneWriter, tmp_path: Path) -> None:
    """An import by other settings is another run."""
    need("lammps")
    scene = scene_file(striker=STRIKER)
    imported(PLAIN, scene, tmp_path / "made")
    (tmp_path / "alone").mkdir()
    shutil.copy(tmp_path / "made" / "my.bin", tmp_path / "alone")
    words = ("--scene", scene, "--engine", "lammps", "--runs", tmp_path / "runs", "--dump", tmp_path / "alone/my.bin")
    folders = []
    for further in ((), ("--set", "striker.speed=1.1 m/s")):
        done = beads("import", *words, *further)
        assert done.returncode == 0, done.stderr
        assert "a deck of one's own: not given" in done.stderr
        folders.append(done.stdout)
    assert folders[0] != folders[1]
