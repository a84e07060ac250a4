"""Messages of validation errors: the value found and those allowed."""

from collections.abc import Iterator, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from drivers.base import paths
from drivers.base.errors import MAX_PROBLEMS, InputError, InputProblem
from drivers.base.units import NotAllowedError

Model = TypeVar("Model", bound=BaseModel)
MISPLACED = ("missing", "extra_forbidden")  # types of pydantic's errors on keys
EXPECTED = {  # allowed values by the type of pydantic's error, filled in from its context
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


def validate(model: type[Model], data: object, where: str | Path, prefix: str = "") -> Model:
    """Validate ``data`` as a ``model``; ``where`` is the file, or its name in messages.

    Raises:
        InputError: lists every problem, each with its key, the value found and those allowed.
    """
    try:
        return model.model_validate(data)
    except ValidationError as failure:
        first, *more = _problems(failure.errors(include_url=False), model, prefix)
    raise InputError(where if isinstance(where, str) else paths.shown(where), *first, *more)


def _problems(errors: Sequence[Any], model: type[BaseModel], prefix: str) -> Iterator[InputProblem]:
    """Problems of pydantic's errors, one a key; missing and unknown keys of a table are one problem."""
    wrong: dict[str, InputProblem] = {}
    tables: dict[tuple[int | str, ...], tuple[list[str], list[str]]] = {}
    for error in errors:
        path = _path(error["loc"])
        if error["type"] in MISPLACED:
            tables.setdefault(path[:-1], ([], []))[MISPLACED.index(error["type"])].append(str(path[-1]))
        else:
            key = _dotted(prefix, path)
            wrong.setdefault(key, (key, *_found_and_allowed(error)))
    for table, (missing, unknown) in tables.items():
        yield _misplaced(_dotted(prefix, table), missing, unknown, sorted(model_at(model, table).model_fields))
    yield from wrong.values()


def _path(location: tuple[int | str, ...]) -> tuple[int | str, ...]:
    if location[:2] == ("run", "accuracy"):
        return location[:2]  # the rest names a branch of its type
    return location[:-1] if location and location[-1] == "[key]" else location


def _dotted(prefix: str, path: tuple[int | str, ...]) -> str:
    return (prefix + ".".join(str(part) for part in path)).rstrip(".")


def _misplaced(table: str, missing: list[str], unknown: list[str], known: list[str]) -> InputProblem:
    """The missing and the unknown keys of a table."""
    close = {name: get_close_matches(name, known, 1) for name in unknown[:MAX_PROBLEMS]}  # of the first that are shown
    if len(missing) + len(unknown) == 1:
        (name,) = missing or unknown
        hint = f"did you mean {close[name][0]}?" if close.get(name) else f"allowed: {', '.join(known)}"
        return f"{table}.{name}".lstrip("."), "missing key" if missing else f"unknown key; {hint}", ""
    hinted = [
        f"{name} (did you mean {close[name][0]}?)" if close.get(name) and close[name][0] not in missing else name
        for name in unknown
    ]
    lists = (("missing", missing), ("unknown", hinted))
    found = [f"{kind} key{'s' * (len(keys) > 1)} {', '.join(keys)}" for kind, keys in lists if keys]
    return table, "; ".join(found), ""


def _found_and_allowed(error: Any) -> tuple[str, str]:
    """The value found and those allowed, from one of pydantic's errors."""
    found = shorten(error["input"])
    cause = error.get("ctx", {}).get("error")
    if isinstance(cause, NotAllowedError):
        return found, str(cause)
    expected = EXPECTED.get(error["type"])
    return found, expected.format(**error.get("ctx", {})) if expected else str(error["msg"])


def shorten(value: object) -> str:
    """Quote a value for a message."""
    try:
        text = f'"{value}"' if isinstance(value, str) else repr(value)
    except ValueError:  # a whole number of more digits than Python writes
        return "a number of thousands of digits"
    return text if len(text) <= 60 else text[:57] + "..."


def model_at(model: type[BaseModel], path: Sequence[int | str]) -> type[BaseModel]:
    """Model of the table at ``path``."""
    for part in path:
        if isinstance(part, int) or part not in model.model_fields:
            continue  # an entry of a list, or the free name of a material: of the same model
        parts = parts_of(model.model_fields[part].annotation)
        model = next((kind for kind in parts if isinstance(kind, type) and issubclass(kind, BaseModel)), model)
    return model


def parts_of(annotation: Any) -> list[Any]:
    """Annotation and all parts of which it is composed, including metadata."""
    return [annotation, *(part for argument in get_args(annotation) for part in parts_of(argument))]
