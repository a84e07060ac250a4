"""Decks of real engines with one line changed: the guard fails careless edits and blow-ups."""

import re
import sys
from pathlib import Path

import pytest

from drivers.engines import load_engine
from validation.tests.helpers.runs import failing_run, finished, need
from validation.tests.helpers.scenes import SceneWriter, StandIn, case_of

UNSTABLE = "^unstable at t = "
OF_THE_FAMILY = {
    "NaN": ("timestep        1e-07", "timestep        1e200", UNSTABLE),
    "no strike": ("fix motion", "velocity all set 0 0 0\nfix motion", "body 6 starts with a velocity of 0 m/s"),
    "half way": ("run             3000", "run             1500", "output ends in sample 152 of 301"),
    "a little force": ("fix motion", "fix push all addforce 0 0 -1e-3\nfix motion", f"{UNSTABLE}.*energy is off"),
}
SABOTAGE = {
    "lammps": OF_THE_FAMILY | {
        "a lost bead": ("fix motion", "fix push all addforce 1000 0 0\nfix motion", f"{UNSTABLE}.*Lost atoms"),
        "an error in the deck": ("pair_style      gran", "pair_style      grain", "pair style"),
        "a step far too large": ("timestep        1e-07", "timestep        2.5e-05", UNSTABLE),
    },
    "liggghts": OF_THE_FAMILY | {
        "a lost bead": ("fix motion", "fix push all addforce 100 0 0\nfix motion", f"{UNSTABLE}.*Lost atoms"),
        "an error in the deck": ("pair_style      gran", "pair_style      grain", "Invalid pair style"),
        "a step far too large": ("timestep        1e-07", "timestep        2.5e-05", f"{UNSTABLE}.*Lost atoms"),
    },
    "yade": {
        "NaN": ("O.dt = time_step", "O.dt = float('nan')", f"{UNSTABLE}.*values are not finite"),
        "an error in the deck": ("O.dt = time_step", "O.dt = steptime", "NameError: name 'steptime' is not defined"),
        "half way": ("np.savez(", "force = force[:150]\nnp.savez(", r"shape \(150, 6\), expected \(301, 6\)"),
        "death before the end": ("start = time.perf_counter()", "import os; os._exit(0)", "chain.npz was not written"),
        "no closing line": ("print(f\"completed", "str(f\"completed", "did not run to its end"),
        "a step far too large": ("O.dt = time_step", "O.dt = 2.5e-5", UNSTABLE),
        "a slower strike": ("(0, 0, velocity)", "(0, 0, 0.9 * velocity)", "body 6 starts with a velocity of -0.9 m/s"),
        "a little damping": ("damping=0", "damping=1e-4", f"{UNSTABLE}.*the energy is off"),
    },
}  # fmt: skip


@pytest.mark.parametrize(("engine", "name"), [(engine, name) for engine in SABOTAGE for name in SABOTAGE[engine]])
def test_sabotaged_decks_on_the_real_engine(
    engine: str, name: str, stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path
) -> None:
    good, bad, words = SABOTAGE[engine][name]
    sabotage(engine, good, bad, stand_in, tmp_path)
    status, reason = failing_run(scene_file(), engine, tmp_path / "runs")
    assert status == "failed"
    assert re.search(words, reason), reason


@pytest.mark.parametrize(
    ("engine", "good", "bad"),
    [("lammps", "zplane 0", "zplane -1"), ("liggghts", "zplane 0", "zplane -1"), ("yade", "wall(0", "wall(-1")],
)
def test_a_bead_that_passes_through_the_wall(
    engine: str, good: str, bad: str, stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path
) -> None:
    sabotage(engine, good, bad, stand_in, tmp_path)
    _, reason = failing_run(scene_file(duration="4 ms", step="0.5 us"), engine, tmp_path / "runs")
    assert re.search(f"{UNSTABLE}.*body 1 passed through the wall", reason), reason


@pytest.mark.parametrize(
    ("engine", "good", "bad"),
    [("lammps", "1e-07", "1.1e-07"), ("liggghts", "1e-07", "1.1e-07"), ("yade", "range(every if", "range(9 if")],
)
def test_a_run_at_another_step_has_a_warning(
    engine: str, good: str, bad: str, stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path
) -> None:
    sabotage(engine, good, bad, stand_in, tmp_path)
    warnings = finished(case_of(scene_file()), engine, tmp_path / "runs").record.warnings
    assert warnings is not None
    (warning,) = warnings
    assert "the engine did not run the scene as written" in warning


def sabotage(engine: str, good: str, bad: str, stand_in: StandIn, tmp_path: Path) -> None:
    """Replaces some words in all later decks of the real engine."""
    need(engine)
    file = next(iter(load_engine(engine).render(case_of("fig4")).files))
    swap = f"""import sys
text = open(sys.argv[1]).read()
assert {good!r} in text
open(sys.argv[1], "w").write(text.replace({good!r}, {bad!r}))
"""
    found = load_engine(engine).find()
    assert found is not None
    (tmp_path / "swap.py").write_text(swap)
    script = f'if [ -e {file} ]; then {sys.executable} {tmp_path}/swap.py {file} || exit 99; fi\nexec {found[0]} "$@"\n'
    stand_in(load_engine(engine).program, script)
