"""Compiled integrators: compilation is announced and complete after ``make setup``; signals arrive as they are."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from validation.reference.adaptive import integrate_adaptive
from validation.reference.hertz_chain import HertzChain, Motion
from validation.reference.symplectic import integrate_symplectic
from validation.reference.velocity_verlet import integrate_verlet
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


INTEGRATORS: dict[str, Callable[[HertzChain], Motion]] = {
    "adaptive": lambda chain: integrate_adaptive(chain, np.linspace(0, 40, 41), 1e-10),
    "verlet": lambda chain: integrate_verlet(chain, 1e-3, 1000, 41),
    "symplectic": lambda chain: integrate_symplectic(chain, 1e-3, 1000, 41),
}


@pytest.fixture
def interrupting() -> Iterator[None]:
    former = signal.signal(signal.SIGUSR1, signal.default_int_handler)
    yield
    signal.signal(signal.SIGUSR1, former)


@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_signal_in_compiled_code_keeps_its_exception(name: str, interrupting: None) -> None:
    """Not a SystemError, which a batch would charge to the case that a cancelled job was computing."""
    count = 100
    at_rest, one = np.zeros(count), np.ones(count)
    chain = HertzChain(one, one, at_rest, -np.eye(count)[-1], at_rest)
    integrate = INTEGRATORS[name]
    integrate(chain)
    began = time.perf_counter()
    integrate(chain)
    half_s = (time.perf_counter() - began) / 2
    for _ in range(10):
        with pytest.raises(KeyboardInterrupt):
            _interrupted(lambda: integrate(chain), half_s)


def _interrupted(work: Callable[[], object], after_s: float) -> None:
    timer = threading.Timer(after_s, os.kill, (os.getpid(), signal.SIGUSR1))
    timer.start()
    work()
    timer.join()
