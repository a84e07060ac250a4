"""Validation errors in words: what was found, what is allowed."""

from collections.abc import Sequence
from difflib import get_close_matches
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from drivers.base.errors import InputError
from drivers.base.units import NotAllowedError

Model = TypeVar("Model", bound=BaseModel)
EXPECTED = {  # by the type of pydantic's error, with what its context names
    "int_type": "a whole number",
    "float_type": "a plain number",
    "bool_type": "true or false",
    "string_type": "text in quotes",
    "finite_number": "a finite number",
    "model_type": "a table",
    "dict_type": "a table",
    "tuple_type": "a list",
    "greater_than": "above {gt:g}",
    "greater_than_equal": "{ge:g} or more",
    "less_than": "below {lt:g}",
    "less_than_equal": "at most {le:g}",
    "literal_error": "{expected}",
    "string_pattern_mismatch": "letters, digits, '-' and '_', beginning with a letter",
    "string_too_long": "at most {max_length} characters",
}


def validate(model: type[Model], data: object, where: str, prefix: str = "") -> Model:
    """``data`` as a ``model``; its first problem becomes an InputError."""
    try:
        return model.model_validate(data)
    except ValidationError as failure:
        first = failure.errors(include_url=False)[0]
        more = failure.error_count() - 1
        path = list(first["loc"])
        if path[:2] == ["run", "accuracy"]:
            path = path[:2]  # what follows names a branch of its type
        elif path and path[-1] == "[key]":
            path.pop()
        key = (prefix + ".".join(str(part) for part in path)).rstrip(".")
        found, allowed = _told(first, model, path)
        raise InputError(where, key, found, allowed + (f" (and {more} more to mend)" if more else "")) from None


def _told(error: Any, model: type[BaseModel], path: list[int | str]) -> tuple[str, str]:
    """What was found and what is allowed, in words, from one of pydantic's errors."""
    if error["type"] == "extra_forbidden":
        keys = keys_at(model, path[:-1])
        close = get_close_matches(str(path[-1]), keys, 1)
        return "an unknown key", f"did you mean {close[0]}?" if close else ", ".join(keys)
    if error["type"] == "missing":
        return "nothing", "this key is needed"
    found = shorten(error["input"])
    cause = error.get("ctx", {}).get("error")
    if isinstance(cause, NotAllowedError):
        return found, str(cause)
    expected = EXPECTED.get(error["type"])
    return found, expected.format(**error.get("ctx", {})) if expected else str(error["msg"])


def shorten(value: object) -> str:
    """A value as a message quotes it."""
    try:
        text = f'"{value}"' if isinstance(value, str) else repr(value)
    except ValueError:  # a whole number of more digits than Python writes
        return "a number of thousands of digits"
    return text if len(text) <= 60 else text[:57] + "..."


def keys_at(model: type[BaseModel], path: Sequence[int | str]) -> list[str]:
    """The keys that a table may have, following ``path`` down the models."""
    for part in path:
        if isinstance(part, int) or part not in model.model_fields:
            continue  # an entry of a list, or the free name of a material: the same model goes on
        found = _models_in(model.model_fields[part].annotation)
        model = found[0] if found else model
    return sorted(model.model_fields)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for part in getattr(annotation, "__args__", ()) for found in _models_in(part)]
