"""Numbers that the paper quotes, from ``inputs/paper/quoted.toml``."""

import tomllib
from functools import cache
from typing import Any

from drivers import paths


@cache
def _tables() -> dict[str, Any]:
    return tomllib.loads(paths.QUOTED.read_text())


def quoted(table: str) -> dict[str, Any]:
    """One table of the file, units in its keys."""
    return dict(_tables()[table])
