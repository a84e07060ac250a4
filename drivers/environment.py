"""Importing this module ends the program with one line if Python or a package is missing.

Commands import it first. This module and its imports must be valid syntax for Python before 3.11. From here on Ctrl-C
ends the program without a traceback.
"""

import re
import sys
from importlib.util import find_spec
from pathlib import Path

from drivers.base import paths

sys.excepthook = lambda kind, *more: None if kind is KeyboardInterrupt else sys.__excepthook__(kind, *more)


def trouble() -> str:
    """Missing Python version or packages and the command that installs them; empty if all are there."""
    if sys.version_info < (3, 11):  # noqa: UP036 - the user's Python may be older
        lacking = f"Python {sys.version_info[0]}.{sys.version_info[1]}, and 3.11 or later is needed"
    else:
        file = paths.ROOT / "pyproject.toml"  # missing if the packages were copied alone
        project = file.read_text(encoding="utf-8") if file.exists() else ""
        listed = project.partition("\ndependencies = [")[2].partition("]")[0]
        needed = set(re.findall(r'"([\w-]+)', listed))
        missing = sorted(name for name in needed if find_spec(name) is None)
        if not missing:
            return ""
        lacking = f"Python without {', '.join(missing[:3])}{', ...' * (len(missing) > 3)}"
    home = paths.ROOT / ".venv"
    entered = Path(sys.prefix).resolve() == home.resolve()
    if entered or not (home / "bin" / "activate").exists():
        return f"{lacking}: make{'' if Path.cwd() == paths.ROOT else f' -C {paths.ROOT}'} setup"
    return f"{lacking}: . {paths.shown(home / 'bin' / 'activate')}"


problem = trouble()
if problem:
    print(problem, file=sys.stderr)
    sys.exit(2)
