"""Numbers of random scenes: a few in the quick tests, the rest in the long ones."""

from typing import Any

import pytest


def draws(count: int, quick: int = 3) -> list[Any]:
    """Parameters from 0 to ``count``; those from ``quick`` on are long tests."""
    return [pytest.param(number, marks=pytest.mark.long if number >= quick else ()) for number in range(count)]
