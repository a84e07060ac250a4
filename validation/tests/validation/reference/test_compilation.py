"""Compiled integrators: compilation is announced and complete after ``make setup``; signals arrive as they are."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from math import inf
from pathlib import Path

import numpy as np
import pytest
from numba import config

from drivers.chain.schemes import endable
from validation.reference import contact_kernels
from validation.reference.adaptive import integrate_adaptive
from validation.reference.hertz_chain import HertzChain
from validation.reference.symplectic import integrate_symplectic
from validation.reference.velocity_verlet import integrate_verlet

INTEGRATION = """import numpy as np
from validation.reference.hertz_chain import HertzChain
from validation.reference.symplectic import integrate_symplectic
one = np.ones(2)
integrate_symplectic(HertzChain(one, one, one, one, one), 1e-3, 1, 2)"""


def test_a_line_says_that_the_integrators_are_compiled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    for line in ("compiling the integrators, once after a change of them\n", ""):  # the second time code is loaded
        ended = subprocess.run([sys.executable, "-c", INTEGRATION], capture_output=True, text=True, check=True)
        assert (ended.stdout, ended.stderr) == ("", line)


def test_compiled_code_is_kept_only_where_nobody_else_can_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(contact_kernels, "HOME", tmp_path / "read-only")
    monkeypatch.setitem(vars(config), "CACHE_DIR", "")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    own = tmp_path / "cache" / "bead-chains"
    assert contact_kernels._cache_folder() == own
    assert own.stat().st_mode & 0o777 == 0o700
    own.chmod(0o770)
    assert contact_kernels._cache_folder() is None
    own.chmod(0o700)
    if os.geteuid() == 0:
        os.chown(own.parent, 1, 1)
        assert contact_kernels._cache_folder() is None


def test_without_such_a_folder_a_line_says_that_each_process_compiles(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", os.devnull)
    read_only = f"import os\nos.access = lambda *given, **more: False\n{INTEGRATION}"
    ended = subprocess.run([sys.executable, "-c", read_only], capture_output=True, text=True, check=True)
    assert ended.stderr.startswith("compiling the integrators, in each process: ")


SIGNATURES = """import gc, sys, time
from numba.core.dispatcher import Dispatcher
from validation.reference.__main__ import _compile_elastic, _compile_others
from validation.tests.helpers.commands import beads
{work}
for kernel in gc.get_objects():
    if isinstance(kernel, Dispatcher):
        print(*(f"{{kernel.py_func.__qualname__}}{{signature}}" for signature in kernel.signatures), sep="\\n")
"""
SETUP = """import numpy as np
from validation.reference.hertz_chain import HertzChain
one = np.ones(2)
for compile in (_compile_elastic, _compile_others):
    compile(HertzChain(one, one, 0 * one, -np.arange(2.0), 0 * one))"""
COMMANDS = """for words in (
    ("plan", "fig4", "--set", "contact.dissipation=power", "--set", "contact.gamma=1.25"),
    ("plan", "fig4-tube"),
    ("run", "fig4", "--engine", "verlet", "--engine", "reference", "--rerun", "--runs", sys.argv[1]),
):
    done = beads(*words, "--set", f"striker.speed={1 + time.time_ns() % 10**6 / 10**6} m/s")  # a plan that is not kept
    assert (done.returncode, done.stderr) == (0, ""), done"""


def signatures_after(work: str, *words: Path) -> set[str]:
    """Kernels in use after some work in a process of its own, with the types of their arguments."""
    command = [sys.executable, "-c", SIGNATURES.format(work=work), *map(str, words)]
    return set(subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines())


@pytest.mark.long
def test_setup_compiles_every_kernel_of_the_commands(tmp_path: Path) -> None:
    compiled = signatures_after(SETUP)
    used = signatures_after(COMMANDS, tmp_path)
    assert len(used) > 4
    assert used <= compiled


@pytest.mark.parametrize(
    "integrate",
    [
        pytest.param(lambda chain: integrate_adaptive(chain, np.linspace(0, 40, 41), 1e-10), id="adaptive"),
        pytest.param(lambda chain: integrate_verlet(chain, 1e-3, 1000, 41), id="verlet"),
        pytest.param(lambda chain: integrate_symplectic(chain, 1e-3, 1000, 41), id="symplectic"),
    ],
)
def test_a_signal_in_compiled_code_keeps_its_exception(integrate: Callable[[HertzChain], object]) -> None:
    """A SystemError in its place would be charged to the case that a cancelled job was computing."""
    one = np.ones(100)
    chain = HertzChain(one, one, 0 * one, -np.eye(100)[-1], 0 * one)
    integrate(chain)
    began = time.perf_counter()
    integrate(chain)
    half_s = (time.perf_counter() - began) / 2

    def interrupted() -> None:
        timer = threading.Timer(half_s, os.kill, (os.getpid(), signal.SIGUSR1))
        timer.start()
        integrate(chain)
        timer.join()

    former = signal.signal(signal.SIGUSR1, signal.default_int_handler)
    try:
        for _ in range(5):
            with pytest.raises(KeyboardInterrupt):
                interrupted()
    finally:
        signal.signal(signal.SIGUSR1, former)


@pytest.mark.parametrize("work", [1, inf], ids=["here", "in a thread"])
def test_compilation_does_not_count_in_the_time_limit(work: float) -> None:
    def integrate(compiled: bool, _: object) -> bool:
        if compiled:
            contact_kernels.LISTENER.on_start(None)
        time.sleep(1.0)
        if compiled:
            contact_kernels.LISTENER.on_end(None)
        return compiled

    contact_kernels.LISTENER.total_s += 1.0  # else a line is printed
    assert endable(partial(integrate, True), 0.7, work)
    with pytest.raises(TimeoutError):
        endable(partial(integrate, False), 0.7, work)
