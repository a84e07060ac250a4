"""Settings: ``path=value`` pairs laid over the tables of a scene file."""

import tomllib
from typing import Any

from drivers.base.errors import InputError


def lay_over(data: dict[str, Any], setting: str) -> None:
    """Sets one ``path=value`` in the tables of a scene file.

    Raises:
        InputError: there is no such place.
    """
    where = f"--set {setting}"
    path, equals, text = setting.partition("=")
    if not equals or not all(path.strip().split(".")):
        raise InputError(where, "", "no path=value", "a key of the scene and its value, such as chain.count=60")
    set_value(data, path.strip(), read_value(text), where)


def set_value(data: dict[str, Any], path: str, value: Any, where: str) -> None:
    """Sets the value at a path such as ``chain.sensors.0.mass``; an empty text leaves the key out.

    Raises:
        InputError: there is no such place.
    """
    *keys, last = path.split(".")
    here: Any = data
    for key in keys:
        here = _step_into(here, key, where)
    if isinstance(here, list):
        here[_index(here, last, where)] = value
    elif not isinstance(here, dict):
        raise InputError(where, path, "a key below a plain value", "a key of a table")
    elif value != "":
        here[last] = value
    else:
        here.pop(last, None)


def _step_into(here: Any, key: str, where: str) -> Any:
    if isinstance(here, list):
        return here[_index(here, key, where)]
    if isinstance(here, dict):
        return here.setdefault(key, {})
    raise InputError(where, key, "a key below a plain value", "a key of a table")


def _index(entries: list[Any], key: str, where: str) -> int:
    if not (key.isascii() and key.isdecimal() and len(key) < 9) or int(key) >= len(entries):
        raise InputError(where, key, f"no such entry among {len(entries)}", "a place in the list, counted from 0")
    return int(key)


def read_value(text: str) -> Any:
    """A value as TOML has it, or else plain text."""
    try:
        table = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        table = {}
    return table["value"] if list(table) == ["value"] else text.strip()
