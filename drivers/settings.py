"""Settings: ``path=value`` pairs laid over the tables of a scene file."""

import tomllib
from typing import Any

from drivers.errors import InputError


def lay_over(data: dict[str, Any], setting: str) -> None:
    """Sets one ``path=value`` in the tables of a scene file."""
    where = f"--set {setting}"
    path, equals, text = setting.partition("=")
    keys = path.strip().split(".")
    if not equals or not all(keys):
        raise InputError(where, "", "no path=value", "a key of the scene and its value, such as chain.count=60")
    here: Any = data
    for key in keys[:-1]:
        here = _step_into(here, key, where)
    last = keys[-1]
    if isinstance(here, list):
        here[_index(here, last, where)] = _value(text)
    elif not isinstance(here, dict):
        raise InputError(where, path, "a key below a plain value", "a key of a table")
    elif text.strip():
        here[last] = _value(text)
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


def _value(text: str) -> Any:
    try:
        table = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        table = {}
    return table["value"] if list(table) == ["value"] else text.strip()
