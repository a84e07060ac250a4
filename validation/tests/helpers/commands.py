"""Commands run as by a user."""

import os
import re
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from unittest.mock import patch

from validation.commands.beads import main

BEADS = (sys.executable, "-m", main.__module__)  # the command, also where it is not installed
PROGRESS = re.compile(r": (\d+ of \d+ \w+ in )?(\d+:)?\d\d:\d\d(, \S+ left)?$", re.MULTILINE)


def beads(*words: str | Path) -> subprocess.CompletedProcess[str]:
    """Run ``beads ...`` as a user does, but in this process, which has loaded all libraries.

    Lines on progress, which depend on the machine, are removed.
    """
    given = ["beads", *map(str, words)]
    out, err, code = StringIO(), StringIO(), None
    argv, same_environment = patch.object(sys, "argv", given), patch.dict(os.environ)
    with argv, same_environment, redirect_stdout(out), redirect_stderr(err):
        try:
            main()
        except SystemExit as end:
            code = end.code
    assert isinstance(code, int), code
    return subprocess.CompletedProcess(given, code, out.getvalue(), without_progress(err.getvalue()))


def beads_process(*words: str | Path, **changes: str) -> subprocess.CompletedProcess[str]:
    """Run ``beads ...`` in a process of its own, with changed variables of the environment."""
    done = subprocess.run(
        [*BEADS, *map(str, words)],
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
