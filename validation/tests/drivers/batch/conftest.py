"""Fixtures of tests of batches."""

from pathlib import Path

import pytest

from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import EnginesWriter

PROFILE = """
module() {{
  test "$1 $2" = "load dem" || {{ echo "module: $2 not found" >&2; return 1; }}
  export PATH="{folder}:$PATH"
}}
"""


@pytest.fixture
def modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, engines_file: EnginesWriter) -> Path:
    """Engine ``by-module``, found after ``module load dem``, a command of login shells alone; returns its folder."""
    need("lammps")
    home, folder = tmp_path / "home", tmp_path / "modules"
    for each in (home, folder):
        each.mkdir()
    (home / ".bash_profile").write_text(PROFILE.format(folder=folder))
    monkeypatch.setenv("HOME", str(home))
    (folder / "lmp-of-module").write_text('#!/bin/sh\nexec lmp "$@"\n')
    (folder / "lmp-of-module").chmod(0o755)
    engines_file('[by-module]\nadapter = "lammps"\ncommand = "lmp-of-module"\nhow_to_get = "module load dem"\n')
    return folder
