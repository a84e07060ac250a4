"""Compiled functions shared by the integrators: the contact law (for arrays: ``hertz_chain``) and copying."""

import hashlib
import multiprocessing
import os
import sys
import time
from contextlib import suppress
from math import sqrt
from pathlib import Path
from typing import Any

from numba import config, njit
from numba.core import event

from validation.reference.hertz_chain import SAME_TIME, Array, wave

HOME = Path(__file__).parent


def _cache_folder() -> Path | None:
    """Folder for compiled code, which runs when it is loaded: the given one, or one where nobody else can write.

    It is in the checkout, else in the cache of the user; None if both fail.
    """
    if given := vars(config)["CACHE_DIR"]:
        return Path(given)
    folder = HOME / "__pycache__"
    if os.access(folder if folder.exists() else HOME, os.W_OK):
        return folder
    with suppress(OSError, RuntimeError):  # no home, or none to write to
        folder = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser().resolve() / "bead-chains"
        folder.mkdir(0o700, parents=True, exist_ok=True)
        safe = all(place.stat().st_uid in (0, os.geteuid()) for place in (folder, *folder.parents))
        if safe and not folder.stat().st_mode & 0o022:
            return folder
    return None


CACHE = _cache_folder()
if CACHE:  # numba notices changes in a function's own file only, not in files of called functions: a folder per state
    SOURCES = hashlib.sha256(b"".join(file.read_bytes() for file in sorted(HOME.glob("*.py")))).hexdigest()
    vars(config)["CACHE_DIR"] = str(CACHE / f"kernels-{SOURCES[:12]}")
CACHED = CACHE is not None
WHEN = "once after a change of them" if CACHE else "in each process: NUMBA_CACHE_DIR may name a folder to keep them in"


class _Listener(event.Listener):
    """Prints a line before the first compilation of a process, which takes seconds, and sums the time of all."""

    depth, began_s, total_s = 0, 0.0, 0.0

    def on_start(self, _: event.Event | None) -> None:
        """Count the begin of a compilation, perhaps within another one."""
        if self.depth == 0:
            if not self.total_s and multiprocessing.parent_process() is None:
                print(f"compiling the integrators, {WHEN}", file=sys.stderr, flush=True)
            self.began_s = time.perf_counter()
        self.depth += 1

    def on_end(self, _: event.Event | None) -> None:
        """Count its end."""
        self.depth -= 1
        if self.depth == 0:
            self.total_s += time.perf_counter() - self.began_s


LISTENER = _Listener()
event.register("numba:compile", LISTENER)  # type: ignore[no-untyped-call]  # numba has no annotations there


def compiled_s() -> float:
    """Time in s that this process has compiled until now."""
    return LISTENER.total_s + (time.perf_counter() - LISTENER.began_s if LISTENER.depth else 0.0)


@njit(error_model="numpy", forceinline=True)
def elastic_force(stiffness: float, overlap: float) -> float:
    """``F = k d^(3/2)`` of one closed contact."""
    return stiffness * overlap * sqrt(overlap)


@njit(error_model="numpy", forceinline=True)
def root_raised(root: float, overlap_power: float) -> float:
    """``d^p`` from ``sqrt(d)``; without a general power, which dominates the run time, for p = 1/4, 1/2 and 3/2."""
    if overlap_power == 0.25:
        return sqrt(root)
    if overlap_power == 1.5:
        return root * root * root
    return root if overlap_power == 0.5 else float(root ** (2.0 * overlap_power))


@njit(error_model="numpy", forceinline=True)
def damped_force(stiffness: float, damping: float, overlap_power: float, overlap: float, closing: float) -> float:
    """``F = max(0, k d^(3/2) + C d^p d')`` of one closed contact."""
    root = sqrt(overlap)
    return max(stiffness * overlap * root + damping * root_raised(root, overlap_power) * closing, 0.0)


@njit(error_model="numpy", forceinline=True)
def raised(speed: float, alpha: float) -> float:
    """``speed^alpha``; by square roots for PTFE's exponent 1.75, since a general power dominates the run time."""
    if alpha == 1.75:
        root = sqrt(speed)
        return speed * root * sqrt(root)
    return float(speed**alpha)


@njit(error_model="numpy", forceinline=True)
def power_force(stiffness: float, gamma: float, alpha: float, overlap: float, closing: float) -> float:
    """``F = max(0, k d^(3/2) + gamma sgn(d') |d'|^alpha)`` of one closed contact."""
    rate = gamma * raised(abs(closing), alpha)
    return max(stiffness * overlap * sqrt(overlap) + (rate if closing > 0.0 else -rate), 0.0)


@njit(error_model="numpy", forceinline=True)
def copy(source: Array, target: Array) -> None:
    """``target[:] = source`` as a loop: the assignment itself takes three seconds to compile."""
    for i in range(target.size):
        target[i] = source[i]


segment_value: Any = njit(error_model="numpy")(wave)


@njit(error_model="numpy")
def drive_value(segments: Array, time: float) -> tuple[float, float, float]:
    """Value, rate and second derivative of a drive (``validation.reference.hertz_chain``) at one time."""
    low, high = 0, len(segments)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if segments[middle, 0] <= time * SAME_TIME else (low, middle)
    value, rate, bend = segment_value(segments[low], time - segments[low, 0])
    return value, rate, bend
