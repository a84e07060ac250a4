"""Compilation of the integrators: announced where it happens, and complete after ``make setup``."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

from validation.tests.helpers.commands import beads_process

LINE = "compiling the integrators, once after a change of them\n"
INTEGRATION = """import numpy as np
from validation.reference.hertz_chain import HertzChain
from validation.reference.velocity_verlet import integrate_verlet
one = np.ones(2)
integrate_verlet(HertzChain(one, one, one, one, one), 1e-3, 1, 2)"""


def test_a_line_says_that_the_integrators_are_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    for said in (LINE, ""):  # the second time the compiled code is loaded
        ended = subprocess.run([sys.executable, "-c", INTEGRATION], capture_output=True, text=True, check=True)
        assert (ended.stdout, ended.stderr) == ("", said)


@pytest.mark.long
def test_after_setup_no_command_compiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "compiled"))
    subprocess.run([sys.executable, "-m", "validation.reference"], check=True)
    new = f"striker.speed={1 + time.time_ns() % 10**6 / 10**6} m/s"  # a plan that is not kept
    for words in (
        ("plan", "fig4"),
        ("plan", "fig4", "--set", "contact.restitution=0.9"),
        ("plan", "fig4", "--set", "contact.dissipation=power", "--set", "contact.gamma=1.25"),
        ("plan", "fig4-tube"),
        ("run", "fig4", "--engine", "verlet", "--engine", "reference", "--rerun", "--runs", tmp_path / "runs"),
    ):
        ended = beads_process(*words, "--set", new)
        assert (ended.returncode, ended.stderr) == (0, ""), words
