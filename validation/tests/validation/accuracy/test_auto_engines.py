"""``--engine auto``: costs of engines, and engines that it leaves out since their build or their run failed."""

import sys
from dataclasses import replace
from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers import engines as engines_module
from drivers.base.cache import load, store
from drivers.base.errors import RunError
from drivers.chain.case import Case
from drivers.engines import REFERENCE, VERLET, codes, engine_names, load_engine
from drivers.run import scheme as comparator
from drivers.run.compute import Computed, compute
from drivers.run.run_folder import RECORD
from validation.accuracy import costs
from validation.accuracy.costs import Cost, cost_on, kit_key
from validation.commands import key_commands
from validation.tests.engine.candidate import MINE
from validation.tests.engine.kit import Kit
from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import EnginesWriter, SceneWriter

ORDER = ("mine", "other", VERLET, REFERENCE)  # the cheapest first
FAILS = "\nENGINE = replace(ENGINE, render=lambda case, of=ENGINE.render: replace(of(case), command=('false',)))\n"
MISSES = """
def read(case, folder, read=ENGINE.read):
    trace = read(case, folder)
    return replace(trace, force_N=trace.force_N * (1 + 1e-3))
ENGINE = replace(ENGINE, read=read)
"""
LEFT_OUT = "; --engine auto leaves it out\n"
FAILED_KIT = "scene: {0}: its build failed beads engine {0}" + LEFT_OUT


def only_installed(monkeypatch: pytest.MonkeyPatch, *engines: str) -> None:
    monkeypatch.setattr(costs, "installed", lambda names: [name for name in names if name in engines])


@pytest.fixture
def scene(
    scene_file: SceneWriter, engines_file: EnginesWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """A scene in the present folder, with two cheap engines that fail on every run."""
    (tmp_path / "mine.py").write_text(MINE + FAILS)
    engines_file(
        "".join(f'[{name}]\nadapter = "mine.py"\ncommand = "{sys.executable}"\n' for name in ("mine", "other"))
    )
    monkeypatch.chdir(tmp_path)
    only_installed(monkeypatch, *ORDER)
    monkeypatch.setattr(costs, "cost_on", lambda name: Cost(float((*ORDER, name).index(name)), 0.0, 0.0))
    for name in ("mine", "other"):
        store(kit_key(name), True)
    return scene_file(duration="20 us")


def run(scene: Path, *words: str) -> tuple[int, list[str], list[str]]:
    """Exit code, engines whose folders are printed, and lines of the standard error."""
    done = beads("run", scene, "--engine", "auto", "--runs", "runs", *words)
    return done.returncode, [Path(line).parent.name for line in done.stdout.split()], done.stderr.splitlines(True)


def test_the_next_engine_runs_after_one_that_fails_and_the_failed_one_is_left_out_later(scene: Path) -> None:
    """An engine asked for by name is not left out, and not beside auto."""
    code, engines, (first, second) = run(scene)
    assert (code, engines) == (0, [VERLET])
    assert first.startswith("scene: mine failed: ")
    assert second.startswith("scene: other failed: ")
    assert first.endswith(LEFT_OUT)
    (record,) = Path("runs/mine").glob(f"*/{RECORD}")
    before = record.stat().st_mtime_ns
    code, engines, (first, second) = run(scene)
    assert (code, engines) == (0, [VERLET])
    assert first.startswith("scene: mine: failed: ")
    assert first.endswith(f" (see {record.parent}; --rerun tries again){LEFT_OUT}")
    assert record.stat().st_mtime_ns == before
    assert run(scene, "--rerun")[2][0].startswith("scene: mine failed: ")
    assert record.stat().st_mtime_ns > before
    code, engines, (line,) = run(scene, "--engine", "mine")
    assert (code, engines) == (2, [])
    assert "auto alone" in line


def test_a_build_that_failed_its_tests_is_not_started_and_one_that_misses_the_accuracy_is_left(
    scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that departs from its scheme fails, and misses the accuracy only without that comparison."""
    for name in ("mine", "other"):
        store(kit_key(name), False)
    assert run(scene, "--rerun") == (0, [VERLET], [FAILED_KIT.format("mine"), FAILED_KIT.format("other")])
    assert not Path("runs/mine").exists()
    Path("mine.py").write_text(MINE + MISSES)  # another build, as with a wrong modulus: its run is done
    engines_module._engine_of.cache_clear()  # as in another process
    store(kit_key("mine"), True)
    store(kit_key("other"), False)
    words = ("--set", "run.time_step=", "--set", "run.accuracy=1e-4")
    for begins in ("failed: departs from its scheme ", "missed the accuracy: force has an error of 0.001"):
        code, engines, lines = run(scene, *words, "--rerun")
        assert (code, engines) == (0, [VERLET])
        assert [line for line in lines if line.startswith(f"scene: mine {begins}") and line.endswith(LEFT_OUT)], lines
        monkeypatch.setattr(comparator, "compared", lambda case, engine, trace: trace)


def test_no_engine_is_left(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    only_installed(monkeypatch, "mine", "other")
    store(kit_key("mine"), False)
    code, engines, (first, second, third) = run(scene)
    assert (code, engines, first) == (1, [], FAILED_KIT.format("mine"))
    assert second.startswith("scene: other failed: ")
    assert third == "error: scene: no engine is left for --engine auto, after mine, other\n"
    store(kit_key("other"), False)
    said = beads("plan", scene)
    assert (said.returncode, said.stderr) == (0, "")
    assert "the cheapest first: none is left\n" in said.stdout


def test_the_plan_names_the_engine_of_auto(scene: Path) -> None:
    assert "the cheapest first: mine 0 s, other 1 s" in beads("plan", scene).stdout
    store(kit_key("mine"), False)
    said = beads("plan", scene).stdout  # although a plan is kept
    assert f"the cheapest first: other 1 s, {VERLET} 2 s, {REFERENCE} 3 s\n" in said
    assert "\nleft out   mine: its build failed beads engine mine\n" in said


@pytest.mark.usefixtures("scene")
@pytest.mark.parametrize(("code", "kept"), [(0, True), (1, False), (2, None)])
def test_the_outcome_of_the_tests_of_a_build_is_kept(
    code: int, kept: bool | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tests that were interrupted have no outcome."""
    store(kit_key("mine"), None)

    def main(words: list[str], plugins: list[Kit]) -> int:
        (kit,) = plugins
        kit.session = SimpleNamespace(shouldstop=False)  # type: ignore[assignment]
        kit.failed = {"test_start"} if code == 1 else set()
        return code

    monkeypatch.setattr(pytest, "main", main)
    monkeypatch.setattr(key_commands, "measured_cost", lambda engine, build: Cost(1.0, 1.0, 1.0))
    assert beads("engine", "mine").returncode == {0: 0, 1: 1, 2: 130}[code]
    assert load(kit_key("mine")) is kept


def test_a_cost_is_measured_once_for_each_build_and_never_infinite(
    engines_file: EnginesWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """An engine without an entry in the table is measured; one that cannot be is as dear as the dearest."""
    adapter = tmp_path / "mine.py"
    adapter.write_text(MINE)
    commands = {"mine": ("mine.py", sys.executable), "other": (codes()[0], sys.executable)}
    commands["absent"] = ("mine.py", "no-such-program")
    engines_file(
        "".join(f'[{name}]\nadapter = "{of}"\ncommand = "{command}"\n' for name, (of, command) in commands.items())
    )
    costs._measured.cache_clear()
    monkeypatch.setattr(costs, "REPEATS", 1)

    def timed(case: Case, *given: Any, **more: Any) -> Computed:
        """Computed case with a loop of 2 ns a body and step, and 5 ns a body and sample."""
        loop_s = case.chain.bodies * (2e-9 * case.scene.steps + 5e-9 * case.scene.samples)
        return replace(compute(case, *given, **more), loop_s=loop_s)

    monkeypatch.setattr(costs, "compute", timed)
    measured = cost_on("mine")
    assert 0 < measured.start_s < inf
    assert (measured.step_ns, measured.sample_ns) == pytest.approx((2, 5))
    assert "mine: no entry in inputs/costs.toml; cost measured and cached" in capsys.readouterr().err

    def fails(*_: object) -> Cost:
        raise RunError("out of order")

    monkeypatch.setattr(costs, "measured_cost", fails)
    costs._measured.cache_clear()  # as in another process
    assert cost_on("mine") == measured
    adapter.write_text(f"{MINE}\n# another build\n")
    dearest = max((cost_on(name) for name in engine_names()), key=lambda cost: cost.step_ns)
    assert cost_on("mine") == cost_on("absent") == dearest
    assert cost_on("other") == cost_on(load_engine("other").entry.adapter)
