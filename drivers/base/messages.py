"""Messages of validation errors: the value found and those allowed."""

import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from drivers.base import paths
from drivers.base.errors import MAX_PROBLEMS, InputProblem, refuse_any

Model = TypeVar("Model", bound=BaseModel)
MISPLACED = ("missing", "extra_forbidden")  # types of pydantic's errors on keys
EXPECTED = {  # words of TOML where those of pydantic are of Python, by the type of its error
    "model_type": "a table",
    "dict_type": "a table",
    "tuple_type": "a list",
    "string_pattern_mismatch": "letters, digits, '-' and '_', beginning with a letter",
}


def validate(model: type[Model], data: object, where: str | Path, prefix: str = "", context: object = None) -> Model:
    """Validate ``data`` as a ``model``; ``where`` is the file, or its name in messages, ``context`` that of pydantic.

    Raises:
        InputError: lists the first problem of each key, with the key, the value found and those allowed.
    """
    try:
        return model.model_validate(data, context=context)
    except ValidationError as failure:  # problems on keys come first, as they explain others; the first ones are listed
        errors = sorted(failure.errors(include_url=False), key=lambda error: error["type"] not in MISPLACED)
        shown = where if isinstance(where, str) else paths.shown(where)
        refuse_any(shown, (_problem(error, model, prefix, place < MAX_PROBLEMS) for place, error in enumerate(errors)))
        raise


def _problem(error: Any, model: type[BaseModel], prefix: str, meant: bool) -> InputProblem:
    """Problem of one of pydantic's errors; with ``meant`` it names the key that was meant instead of an unknown one."""
    path = [part for part in error["loc"] if part != "[key]"]
    key = (prefix + ".".join(map(str, path))).rstrip(".")
    if error["type"] == "missing":
        return key, "missing key", ""
    if error["type"] == "extra_forbidden" and meant:
        known = sorted(model_at(model, path[:-1]).model_json_schema()["properties"])
        return key, f"unknown key; {near(str(path[-1]), known) or 'allowed: ' + ', '.join(known)}", ""
    text = EXPECTED.get(error["type"]) or re.sub(r"^\w+ should (be|have) ", "", error["msg"])
    return key, shorten(error["input"]), str(error.get("ctx", {}).get("error") or text)


def near(name: str, known: Iterable[str]) -> str:
    """Question for the known name that is nearest to an unknown one; empty if none is near."""
    by_case = {each.lower(): each for each in known}
    return "".join(f"did you mean {by_case[close]}?" for close in get_close_matches(name.lower(), by_case, 1))


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
