"""Tables of the studies: rows of a frozen dataclass as CSV, read back bit for bit with the types of its fields.

Fields are ``str``, ``int``, ``float`` (NaN is an empty cell) or ``bool``. A field annotated as a mapping has a column
of numbers for each of its keys, in its place: one for each engine, say.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any, TypeVar, get_origin

import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import whole_file

Row = TypeVar("Row")


def frame_of(kind: type[Row], rows: Iterable[Row]) -> pd.DataFrame:
    """Rows as a table, a column for each field; the columns of ``kind`` where there are no rows."""
    rows = list(rows)
    columns: dict[str, list[Any]] = {}
    for field in fields(kind):  # type: ignore[arg-type]  # a dataclass, which its type does not say
        values = [getattr(row, field.name) for row in rows]
        if _is_mapping(field.type):
            columns |= {key: [each.get(key) for each in values] for key in dict.fromkeys(k for v in values for k in v)}
        else:
            columns[field.name] = values
    return pd.DataFrame(columns)


def write_table(path: Path, kind: type[Row], rows: Iterable[Row]) -> None:
    """Writes rows, whole or not at all."""
    write_frame(path, frame_of(kind, rows))


def write_frame(path: Path, table: pd.DataFrame) -> None:
    """Writes a table, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as draft:
        table.to_csv(draft, index=False)


def read_table(path: Path, kind: type[Row], target: str) -> pd.DataFrame:
    """A table that ``make target`` wrote, each column of the type of its field.

    Raises:
        InputError: it is missing or damaged.
    """
    with refused_if_damaged(path, target):
        types: dict[str, Any] = dict.fromkeys(pd.read_csv(path, nrows=0).columns, float)
        types |= {field.name: field.type for field in fields(kind) if not _is_mapping(field.type)}  # type: ignore[arg-type]
        empty = {name: [""] for name, type_ in types.items() if type_ is float}
        table = pd.read_csv(path, dtype=types, keep_default_na=False, na_values=empty)
        missing = [name for name in types if name not in table.columns]
        if missing:
            raise ValueError(f"no column {missing[0]}")
        return table


def read_rows(path: Path, kind: type[Row], target: str) -> list[Row]:
    """The rows of a table that ``make target`` wrote, equal to those that were written.

    Raises:
        InputError: it is missing or damaged.
    """
    table = read_table(path, kind, target)
    mapped = next((field.name for field in fields(kind) if _is_mapping(field.type)), None)  # type: ignore[arg-type]
    names = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    rows = []
    for record in table.to_dict("records"):
        values: dict[str, Any] = {str(key): value for key, value in record.items() if key in names}
        if mapped:
            values[mapped] = {key: value for key, value in record.items() if key not in names and pd.notna(value)}
        rows.append(kind(**values))
    return rows


@contextmanager
def refused_if_damaged(path: Path, target: str) -> Iterator[None]:
    """Turns what reading a table, or computing from it, stumbles over into an error for people.

    Raises:
        InputError: names the file, what is wrong, and the make target that writes it.
    """
    allowed = f"the table that make {target} writes"
    try:
        yield
    except FileNotFoundError as error:
        raise InputError(paths.shown(path), "", "no such file", allowed) from error
    except (ValueError, LookupError, TypeError, AttributeError) as error:  # pandas' own errors are ValueErrors
        raise InputError(paths.shown(path), "", f"a damaged table ({error})", allowed) from error


def _is_mapping(annotation: Any) -> bool:
    return get_origin(annotation) in (dict, Mapping)
