"""Commands run as by a user."""

import os
import re
import subprocess
import sys
from pathlib import Path

PROGRESS = re.compile(r": (\d+ of \d+ \w+ in \d+ s|\d+ s so far)")


def command_line(*words: str | Path, **changes: str) -> subprocess.CompletedProcess[str]:
    """Run ``python -m ...`` as a user does; lines on progress, which depend on the machine, are removed."""
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
    """Standard error without the lines on progress."""
    return "".join(line for line in said.splitlines(keepends=True) if not PROGRESS.search(line))


def assert_in_order(message: str, *parts: str) -> None:
    """Check that a message is one line that contains the parts in order."""
    assert "\n" not in message
    for part in parts:
        assert part in message, (part, message)
        message = message[message.index(part) + len(part) :]
