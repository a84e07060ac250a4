"""Commands as a user types them."""

import os
import subprocess
import sys
from pathlib import Path


def command_line(*words: str | Path, **changes: str) -> subprocess.CompletedProcess[str]:
    """Runs ``python -m ...`` as a user does."""
    return subprocess.run(
        [sys.executable, "-m", *map(str, words)],
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
        env=os.environ | changes,
    )
