"""The example of a code of one's own, compiled and judged."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from validation.tests.helpers.commands import beads_process
from validation.tests.helpers.runs import need_program

EXAMPLE = Path(__file__).parent / "example"


def compiled(folder: Path, change: tuple[str, str] = ("", "")) -> Path:
    """Entry of the example, compiled in a folder after a change."""
    need_program("cc")
    shutil.copytree(EXAMPLE, folder)
    source = folder / "leapfrog.c"
    text = source.read_text()
    assert change[0] in text
    source.write_text(text.replace(*change) if change[0] else text)
    subprocess.run(("cc", "-O2", "-Wall", "-Werror", "-o", "leapfrog", "leapfrog.c", "-lm"), cwd=folder, check=True)
    return folder / "engines.toml"


@pytest.mark.long
def test_the_example_passes_and_a_wrong_one_fails(tmp_path: Path) -> None:
    words = ("engine", "leapfrog", "--engines", compiled(tmp_path / "right"))
    done, again = beads_process(*words), beads_process(*words)
    assert done.returncode == again.returncode == 0, done.stdout
    counts = re.findall(r"^leapfrog: failed 0; .*, (\d+) now, (\d+) before$", done.stdout, re.MULTILINE)
    assert sum(map(int, counts[0])) >= 50
    assert f", 0 now, {sum(map(int, counts[0]))} before" in again.stdout
    assert "[leapfrog]\nstart_s = " in done.stdout
    wrong = compiled(tmp_path / "wrong", ("sqrt(overlap)", "pow(overlap, 0.500001)"))
    done = beads_process("engine", "leapfrog", "--engines", wrong, "--only", "scene or start")
    assert done.returncode == 1
    assert "departs from its scheme" in done.stdout


@pytest.mark.long
def test_the_example_agrees_with_its_scheme(tmp_path: Path) -> None:
    entry = compiled(tmp_path / "example")
    done = beads_process("compare", "fig4", "--engines", entry, "--engine", "leapfrog", "--runs", tmp_path / "runs")
    assert done.returncode == 0, done.stdout
    assert re.search(r"^fig4 .*leapfrog .*pass", done.stdout, re.MULTILINE), done.stdout
