"""Tests of builds: a run belongs to a build, and own builds and adapters are engines like the shipped ones."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.processes import run_command
from drivers.engines import codes, engine_names, installed, installed_codes, load_engine
from drivers.run.build import build_of
from drivers.run.run import run_case
from postproc.read.residual import residual
from validation.tests.drivers.batch.test_batch import results_of, stored
from validation.tests.helpers.commands import beads, beads_process
from validation.tests.helpers.runs import finished, need
from validation.tests.helpers.scenes import SPEEDS, EnginesWriter, SceneWriter, StandIn, StudyWriter, case_of

OWN_ADAPTER = """
from dataclasses import replace

from drivers.engines import load_engine

ENGINE = replace(load_engine("verlet"), integrate=None, version=lambda command: "mine 1.0", style=None)
"""


def batch(study: Path, runs: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    """Batch in a process of its own, since workers know the engines of the process in which they began."""
    return beads_process("batch", study, "--runs", runs, "--results", results_of(runs), *words)


@pytest.mark.parametrize("engine", ["liggghts", pytest.param("yade", marks=pytest.mark.long)])
def test_a_wrong_build_of_the_same_version_gets_its_own_run(
    engine: str, stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path
) -> None:
    """The other build makes the beads softer and passes everything else to the real one, including ``--version``."""
    need(engine)
    case, runs = case_of(scene_file(duration="0.1 ms")), tmp_path / "runs"
    right, verlet = finished(case, engine, runs), finished(case, "verlet", runs)
    softer = "for deck in chain.*; do [ -e $deck ] && sed -i s/1460000000/1459990000/ $deck; done"
    stand_in(engine, f'{softer}\nexec {shutil.which(engine)} "$@"\n')
    wrong = run_case(case, engine, runs)
    assert wrong.folder != right.folder
    assert wrong.record.engine_version == right.record.engine_version
    assert wrong.record.build_sha256 != right.record.build_sha256
    assert wrong.record.executable == str(tmp_path / "bin" / engine)
    assert residual(right.trace, verlet.trace).max() < 1e-9
    assert residual(wrong.trace, verlet.trace).max() > 1e-6
    done = beads("compare", tmp_path / "scene.toml", "--runs", runs)
    assert done.returncode == 1
    assert re.search(rf"{engine} .*fail", done.stdout), done.stdout


def test_a_deck_and_its_record_carry_the_command_of_the_engines_entry(
    engines_file: EnginesWriter, scene_file: SceneWriter, tmp_path: Path
) -> None:
    """Typed by hand, the first line starts the registered program and not another one of the same name."""
    (tmp_path / "mine.py").write_text(OWN_ADAPTER)
    entry = '[own-lammps]\nadapter = "lammps"\ncommand = "mpirun -np 1 /opt/own/lmp"\n'
    engines_file(f'{entry}[mine]\nadapter = "mine.py"\ncommand = "{sys.executable}"\n')
    own = load_engine("own-lammps")
    deck = own.render(case_of("fig4"))
    shown = own.deck_by_hand(deck)
    first = shown.files["chain.in"].partition("\n")[0]
    assert first == "# stdbuf -oL mpirun -np 1 /opt/own/lmp -in chain.in"
    assert [*shown.files] == [*deck.files]
    for name in codes():
        shipped = load_engine(name)
        if name in installed_codes() and shipped.entry.adapter == name:
            assert shipped.deck_by_hand(each := shipped.render(case_of("fig4"))) == each
    run = run_case(case_of(scene_file(duration="20 us")), "mine", tmp_path / "runs")
    assert run.record.command == f"{sys.executable} -m validation.reference chain.json"
    assert run.record.command in (run.folder / "chain.json").read_text().partition("\n")[0]


INSIDE = 'echo "LIGGGHTS (Version 1)" # '
LIBRARY = next(line.split()[-1] for line in Path("/proc/self/maps").read_text().splitlines() if "/libm.so" in line)


@pytest.mark.parametrize(
    "wrapper",
    [
        'inside "$@"',
        'exec "inside"',
        "exec env A=1 inside",
        'exec "$(dirname "$0")/bin/inside" "$@"',
        "exec {folder}/bin/inside",
        "exec {folder}/aside/bin/inside",
        'D="{folder}/bin"\nexec "$D/inside" "$@"',
        "export D={folder}\nexec ${{D}}/bin/inside",
        '"$(dirname "$0")/once-more"',
        ". {folder}/bin/inside",
        '#!{python}\nimport subprocess, sys\nsys.exit(subprocess.call(["inside", *sys.argv[1:]]))',
        "export LD_LIBRARY_PATH={folder}/bin; exec {python} -c 'import math; print(\"LIGGGHTS (Version 1)\")'",
    ],
)
def test_the_program_that_a_script_starts_is_part_of_the_build(
    wrapper: str, engines_file: EnginesWriter, stand_in: StandIn, tmp_path: Path
) -> None:
    """Named by path or by PATH, next to the script, by another script, or a library that is loaded."""
    stand_in("inside", f"{INSIDE}one")
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


@pytest.mark.long
def test_two_builds_have_separate_runs(engines_file: EnginesWriter, study_file: StudyWriter, tmp_path: Path) -> None:
    """One run each, one row each in a batch, the same numbers; an unknown name is no engine."""
    need("liggghts")
    path = engines_file(
        '[liggghts-again]\nadapter = "liggghts"\ncommand = ["no-such-program", "env A=1 liggghts"]\n'
        'time_limit = "1 min"\n[liggghts-gone]\nadapter = "liggghts"\ncommand = "./liggghts"\n'
    )
    assert {"liggghts-again", "liggghts-gone"} <= set(codes())
    assert installed(["liggghts-again", "liggghts-gone"]) == ("liggghts-again",)
    words = ("run", tmp_path / "scene.toml", "--engines", path, "--runs", tmp_path / "runs")
    study = study_file(SPEEDS.format(2), "liggghts", "liggghts-again")
    done = beads(*words, "--engine", "liggghts", "--engine", "liggghts-again")
    assert (done.returncode, done.stderr) == (0, "")
    one, other = (Path(line) for line in done.stdout.splitlines())
    assert (one.parent.name, other.parent.name) == ("liggghts", "liggghts-again")
    head, deck = (one / "chain.in").read_text().split("\n", 1)
    assert (other / "chain.in").read_text() == f"{head.replace('liggghts', 'env A=1 liggghts', 1)}\n{deck}"
    assert (one / "forces.parquet").read_bytes() == (other / "forces.parquet").read_bytes()
    assert json.loads((other / "run.json").read_text())["executable"] == f"{shutil.which('env')} A=1 liggghts"
    assert batch(study, tmp_path / "runs").returncode == 0
    assert set(stored(tmp_path / "runs").values()) == {1}
    assert len(stored(tmp_path / "runs")) == 4
    done = beads(*words, "--engine", "liggghts-gone")
    assert done.returncode == 1
    assert "not installed" in done.stderr


def test_variables_are_passed_on_by_name(engines_file: EnginesWriter, stand_in: StandIn, tmp_path: Path,
                                         monkeypatch: pytest.MonkeyPatch) -> None:  # fmt: skip
    stand_in("teller", 'echo "LIGGGHTS (Version $MODULE_ONE $OTHER"')
    monkeypatch.setenv("MODULE_ONE", "one")
    monkeypatch.setenv("OTHER", "two")
    engines_file('[mine]\nadapter = "liggghts"\ncommand = "teller"\nvariables = ["MODULE_*"]\n')
    engine = load_engine("mine")
    command = engine.find()
    assert command is not None
    run_command(command, tmp_path, 10.0, **engine.environment)
    assert (tmp_path / "stdout.txt").read_text() == "LIGGGHTS (Version one \n"
    before = build_of(engine)
    assert before.version == "LIGGGHTS (Version one"
    monkeypatch.setenv("OTHER", "three")
    assert build_of(engine) == before
    monkeypatch.setenv("MODULE_ONE", "another")
    assert build_of(engine).sha256 != before.sha256


def test_a_programs_memory_is_its_own(tmp_path: Path) -> None:
    """The memory of this process is not counted."""
    large = np.ones(50_000_000)
    small = run_command(("true",), tmp_path, 10.0).memory_bytes
    more = run_command((sys.executable, "-c", "bytearray(100_000_000)"), tmp_path, 10.0).memory_bytes
    assert small < 30e6 < 100e6 < more < 150e6 < large.nbytes


@pytest.mark.long
def test_an_adapter_from_elsewhere_is_an_engine_everywhere(
    engines_file: EnginesWriter, study_file: StudyWriter, tmp_path: Path
) -> None:
    """Also with the file name of a shipped one; a changed adapter makes new runs, and its errors are run errors."""
    (tmp_path / "yade.py").write_text(OWN_ADAPTER)
    path = engines_file(f'[mine]\nadapter = "yade.py"\ncommand = "{sys.executable}"\n')
    assert "mine" in installed_codes()
    assert (load_engine("mine").program, load_engine("yade").program) == (load_engine("verlet").program, "yade")
    words = ("compare", tmp_path / "scene.toml", "--engine", "mine", "--engines", path, "--runs")
    study, runs = study_file(SPEEDS.format(3), "verlet"), tmp_path / "runs"
    done = beads_process(*words, runs)
    assert done.returncode == 0, done.stderr
    assert re.search(r"^scene +mine .*pass", done.stdout, re.MULTILINE)
    assert batch(study, runs, "--engine", "mine").returncode == 0
    before = set(stored(runs))
    later = "\nENGINE = replace(ENGINE, read=lambda case, folder: 1 / 0)\n"
    (tmp_path / "yade.py").write_text(f"{OWN_ADAPTER}{later}")
    done = beads_process(*words, runs)
    assert done.returncode == 1
    assert re.search(r"^scene +mine .*fail: .*yade.py:8: ZeroDivisionError", done.stdout, re.MULTILINE)
    assert "Traceback" not in done.stderr
    (tmp_path / "yade.py").write_text(f"{OWN_ADAPTER}\n# another\n")
    assert batch(study, runs, "--engine", "mine").returncode == 0
    assert set(stored(runs)) > before


def test_another_adapter_under_the_same_name_is_another_build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another folder's ``mine``, started by the same program, while the first stays as it is."""
    found = set[str]()
    for folder in (tmp_path / "one", tmp_path / "two"):
        folder.mkdir()
        (folder / "mine.py").write_text(f"{OWN_ADAPTER}\n# {folder.name}\n")
        (folder / "engines.toml").write_text(f'[mine]\nadapter = "mine.py"\ncommand = "{sys.executable}"\n')
        monkeypatch.setenv(paths.ENGINES_VARIABLE, str(folder / "engines.toml"))
        found.add(build_of(load_engine("mine")).sha256)
    assert len(found) == 2


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[liggghts]\ncomand = "lmp"', r"liggghts.comand: unknown key; did you mean command\?"),
        ('[liggghts]\ncommand = "lmp \\u0000"', 'liggghts.command: found "lmp ?"; allowed: a command such as'),
        ("[liggghts]\ncommand = 3", 'liggghts.command: found 3; allowed: a command such as "mpirun -np 1 lmp"'),
        ("[liggghts]\ncommand = []", "liggghts.command: .*a list of them"),
        ("[liggghts]\ncommand = 'lmp \"'", "liggghts.command: .*a command"),
        ('[mine]\nadapter = "lamps"', 'mine.adapter: found "lamps"; allowed: .*yade, or the path of a .py file'),
        ('[mine]\nadapter = "gone.py"', "mine.adapter: .*path of a .py file"),
        ('[liggghts]\ntime_limit = "10"', "liggghts.time_limit: .*a time above zero with its unit"),
        ("[liggghts]\nvariables = [1]", "liggghts.variables"),
        ('[liggghts]\nvariables = "LMP"', "liggghts.variables"),
        ('["../x"]\nadapter = "yade"', "letters, digits"),
        ("liggghts = 1", "liggghts: found 1; allowed: a table"),
        ('[verlet]\nadapter = "yade"', "verlet: found a reserved name"),
        ('[auto]\nadapter = "yade"', "auto: found a reserved name"),
        ("[", "TOML"),
    ],
)
def test_wrong_entries_are_named_in_one_line(text: str, words: str, engines_file: EnginesWriter) -> None:
    path = engines_file(text)
    with pytest.raises(InputError, match=words) as raised:
        engine_names()
    assert path.name in str(raised.value)


def test_a_wrong_adapter_or_file_ends_a_command_with_code_two(engines_file: EnginesWriter, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("import nothing_of_that_name\n")
    (tmp_path / "leaves.py").write_text("raise SystemExit(0)\n")
    (tmp_path / "leaves.toml").write_text('[mine]\nadapter = "leaves.py"\n')
    (tmp_path / "verlet.toml").write_text('[mine]\nadapter = "verlet"\n')
    path = engines_file('[mine]\nadapter = "mine.py"\n')
    others = {
        tmp_path / "leaves.toml": "SystemExit: 0",
        tmp_path / "gone.toml": "file not found",
        tmp_path / "verlet.toml": "mine: found .*in-repo engines take no entry",
    }
    for file, words in {path: "nothing_of_that_name", **others}.items():
        done = beads("run", "fig4", "--engines", file, "--engine", "mine")
        assert done.returncode == 2
        assert re.fullmatch(rf".*{words}.*\n", done.stderr)


FUNCTIONS = [name for name, value in vars(load_engine("yade")).items() if callable(value)]
WRONG = """
def wrong(*given):
    print("wrong")
    {error}

ENGINE = replace(ENGINE, {function}=wrong)
"""


@pytest.mark.parametrize(
    "error", ["return 1 / 0", "yield 1 / 0", "raise ValueError('two\\nlines')", "raise SystemExit"]
)
@pytest.mark.parametrize("function", FUNCTIONS)
def test_an_error_of_any_function_of_an_adapter_is_one_line(
    function: str, error: str, engines_file: EnginesWriter, tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(OWN_ADAPTER + WRONG.format(error=error, function=function))
    engines_file('[mine]\nadapter = "mine.py"\n')
    with pytest.raises(RunError, match=r"^mine.py:10: \w+: [^\n]*$"):
        getattr(load_engine("mine"), function)(tmp_path)


@pytest.mark.parametrize("function", [name for name in FUNCTIONS if name not in ("refusal", "partial_trace")])
def test_a_function_of_an_adapter_that_returns_nothing_is_named(
    function: str, engines_file: EnginesWriter, tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(OWN_ADAPTER + WRONG.format(error="", function=function))
    engines_file('[mine]\nadapter = "mine.py"\n')
    with pytest.raises(RunError, match=f"^mine.py: {function} returns None$"):
        getattr(load_engine("mine"), function)(tmp_path)


@pytest.mark.parametrize("function", ["version", "libraries", "refusal", "render", "request", "read"])
def test_a_command_with_a_wrong_adapter_ends_in_one_line(
    function: str, engines_file: EnginesWriter, scene_file: SceneWriter, tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(OWN_ADAPTER + WRONG.format(error="return 1 / 0", function=function))
    engines_file(f'[mine]\nadapter = "mine.py"\ncommand = "{sys.executable}"\n')
    scene, runs = scene_file(duration="20 us"), ("--runs", tmp_path / "runs")
    (tmp_path / "runs").mkdir()
    for words in (("run", scene, "--engine", "mine", *runs), ("plan", scene, "--engine", "mine")):
        said = beads(*words).stderr.splitlines()
        assert [line for line in said if re.search(r"mine.py:10: ZeroDivisionError: division by zero", line)] == said
        assert len(said) <= 1
    assert beads("runs", "--prune", *runs).returncode == 0


@pytest.mark.parametrize(
    ("pattern", "words"),
    [("completed", "no such group"), ("(completed)", "'completed'"), ("(completed", "error: missing \\)")],
)
def test_a_wrong_loop_pattern_ends_a_run_in_one_line(
    pattern: str, words: str, engines_file: EnginesWriter, scene_file: SceneWriter, tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(f"{OWN_ADAPTER}\nENGINE = replace(ENGINE, loop_pattern={pattern!r})\n")
    engines_file(f'[mine]\nadapter = "mine.py"\ncommand = "{sys.executable}"\n')
    done = beads("run", scene_file(duration="20 us"), "--engine", "mine", "--runs", tmp_path / "runs")
    assert done.returncode in (1, 2)
    assert re.fullmatch(rf".*{words}.*\n", done.stderr)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("import json\n\njson.loads('{')\n", "mine.py:3: JSONDecodeError"),
        ("A = 1", "mine.py: AttributeError: module .* no attribute 'ENGINE'"),
        ("(", r"mine.py: SyntaxError: '\(' was never closed \(mine.py, line 1\)"),
    ],
)
def test_an_adapter_that_cannot_be_loaded_is_named_with_its_line(
    text: str, words: str, engines_file: EnginesWriter, tmp_path: Path
) -> None:
    (tmp_path / "mine.py").write_text(text)
    engines_file('[mine]\nadapter = "mine.py"\n')
    with pytest.raises(InputError, match=f"found {words}"):
        load_engine("mine")
