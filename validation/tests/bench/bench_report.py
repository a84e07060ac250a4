"""Time of ``make report`` in a fresh clone, step by step."""

import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from drivers.base import paths

ANNOUNCED = re.compile(r"step \d+ of \d+: [^(]+|results/report.html: .+")
COMMANDS = (("help", "--help"), ("compare of finished runs", "compare", "fig4"), ("plan", "plan", "fig4"))


def bench_report() -> None:
    """Print the times at which steps begin and the page grows, then the cost of commands on finished runs."""
    print("\nmake report in a fresh clone of the last commit: seconds since packages were installed")
    with tempfile.TemporaryDirectory() as home:
        clone = Path(home, "clone")
        words = ("git", "clone", "-q", str(paths.ROOT), str(clone))
        if subprocess.run(words, check=False).returncode:
            print("not measured: no git clone", file=sys.stderr)
            return
        subprocess.run(("make", "-s", ".venv/.ready", ".venv/.engines"), cwd=clone, check=True)
        process = subprocess.Popen(
            ("make", "report"), cwd=clone, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
        )
        assert process.stdout is not None
        began = time.perf_counter()
        for line in process.stdout:
            if not line.startswith(" ") and (found := ANNOUNCED.match(line)):
                print(f"{time.perf_counter() - began:7.1f}  {found[0].strip()}", flush=True)
        print(f"{time.perf_counter() - began:7.1f}  exit code {process.wait()}")
        print("\nCPU and wall seconds of commands, and of their second call with cached results")
        for what, *arguments in COMMANDS:
            for _ in range(2):
                cpu_s, wall_s = _spent((str(clone / ".venv/bin/beads"), *arguments), clone)
            print(f"{what:<26} {cpu_s:5.2f} {wall_s:5.2f}")


def _spent(words: tuple[str, ...], folder: Path) -> tuple[float, float]:
    """CPU and wall seconds of a command."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(words, cwd=folder, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu_s = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return cpu_s, time.perf_counter() - began
