"""Importing this module makes a missing package, or Ctrl-C, end the program without a traceback.

Commands import it first. This module and its imports must be valid syntax for Python before 3.11.
"""

import sys
from pathlib import Path
from typing import Any

from drivers.base import paths


def end(kind: Any, error: Any, trace: Any) -> None:
    """End the program: with one line that gives the command of the environment if a package is missing."""
    if issubclass(kind, ImportError) and error.name:
        home, version = paths.ROOT / ".venv", ".".join(map(str, sys.version_info[:2]))
        enter = Path(sys.prefix).resolve() != home.resolve() and (home / "bin" / "activate").exists()
        command = f". {paths.shown(home / 'bin' / 'activate')}" if enter else f"make -C {paths.ROOT} setup"
        print(f"Python {version} without {error.name}: {command}", file=sys.stderr)
        sys.exit(2)
    if kind is not KeyboardInterrupt:
        sys.__excepthook__(kind, error, trace)


sys.excepthook = end
