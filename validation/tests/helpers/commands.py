"""Commands as a user types them."""

import os
import re
import subprocess
import sys
from pathlib import Path

PROGRESS = re.compile(r": (\d+ of \d+ \w+ in \d+ s|\d+ s so far)")


def command_line(*words: str | Path, **changes: str) -> subprocess.CompletedProcess[str]:
    """Runs ``python -m ...`` as a user does; what is said of progress, which depends on the machine, is left out."""
    done = subprocess.run(
        [sys.executable, "-m", *map(str, words)],
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
        env=os.environ | changes,
    )
    done.stderr = without_progress(done.stderr)
    return done


def without_progress(said: str) -> str:
    """Lines on the standard error beside those that are said now and then."""
    return "".join(line for line in said.splitlines(keepends=True) if not PROGRESS.search(line))
