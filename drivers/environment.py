"""Imported before anything else by commands: says in one line where Python or its packages are not those needed.

It and what it imports have to be readable for Python before 3.11.
"""

import re
import sys
from importlib.util import find_spec
from pathlib import Path

from drivers.base import paths


def trouble() -> str:
    """What is missing and how to mend it; empty where nothing is."""
    if sys.version_info < (3, 11):  # noqa: UP036 - whoever starts it may have an older one
        found = f"Python {sys.version_info[0]}.{sys.version_info[1]}, and 3.11 or later is needed"
    else:
        file = paths.ROOT / "pyproject.toml"  # where packages are copied without it, nothing is known of their needs
        project = file.read_text(encoding="utf-8") if file.exists() else ""
        listed = project.partition("\ndependencies = [")[2].partition("]")[0]
        needed = set(re.findall(r'"([\w-]+)', listed)) - {"argcomplete"}  # which only shells ask for
        missing = sorted(name for name in needed if find_spec(name) is None)
        if not missing:
            return ""
        found = f"Python without {', '.join(missing[:3])}{', ...' * (len(missing) > 3)}"
    home = paths.ROOT / ".venv"
    entered = Path(sys.prefix).resolve() == home.resolve()
    if entered or not (home / "bin" / "activate").exists():
        return f"{found}: make{'' if Path.cwd() == paths.ROOT else f' -C {paths.ROOT}'} setup"
    return f"{found}: . {paths.shown(home / 'bin' / 'activate')}"


said = trouble()
if said:
    print(said, file=sys.stderr)
    sys.exit(2)
