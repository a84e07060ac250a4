"""Command ``keys``: tables of the keys of input files, on the screen and in ``inputs/README.md``."""

import json
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import click

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.terminal import text_table
from validation.commands.options import command, option

README = paths.INPUTS / "README.md"
BEGIN, END = "<!-- written by: beads keys --write -->\n", "<!-- end of the tables -->\n"
HEADINGS = ("key", "values", "default", "meaning")
Rows = Iterable[Sequence[str]]
ENDS = ("minimum", "maximum", "exclusiveMaximum")
WORDS = {"boolean": "true or false", "string": "text", "object": "table"}  # by type of a JSON schema
Schema = dict[str, Any]


@command("chain", "study --markdown", engines=False)
@click.argument(
    "table",
    metavar="[TABLE]",
    default="",
    help="A table of a scene, such as chain.bead, or a file: scene, study, engines (default: all files).",
)
@option("--markdown", "", "Print the tables in Markdown.")
@option("--write", "", "Write the tables of all files into inputs/README.md.")
def keys(table: str, markdown: bool, write: bool) -> None:
    """List keys of scenes and studies, with units and ranges."""
    if write:
        README.write_text(with_keys(README.read_text()))
        return
    files = key_tables()
    chosen = files if not table else {table: files[table]} if table in files else _part(table, files["scene"])
    for name, rows in chosen.items():
        print(_markdown(name, rows) if markdown else "\n  ".join([f"{name}:", *text_table([HEADINGS, *rows])]))


def key_tables() -> dict[str, list[tuple[str, ...]]]:
    """Rows of the keys of each file, by name."""
    from drivers.batch.study import StudyFile
    from drivers.engines import Entry
    from drivers.scene.model import Scene

    scene, study, engines = (model.model_json_schema() for model in (Scene, StudyFile, Entry))
    files = {"scene": (scene, ""), "study": (study, ""), "engines": (engines, "NAME.")}
    return {file: [*_rows(schema, schema.get("$defs", {}), prefix)] for file, (schema, prefix) in files.items()}


def _rows(table: Schema, tables: Schema, prefix: str) -> Iterator[tuple[str, ...]]:
    """Row of each key of a table, and after that of a table in it the rows of its keys, with dots between names.

    Args:
        table: JSON schema of the table.
        tables: JSON schemas of all tables by name.
        prefix: what comes before the names.
    """
    for name, field in table["properties"].items():
        kinds = [kind for kind in field.get("anyOf", [field]) if kind.get("type") != "null"]
        key, default = f"{prefix}{name}", field.get("default")
        empty = default in (None, "", []) or isinstance(default, dict)
        text = "" if empty else _number(default) if isinstance(default, float) else json.dumps(default)
        text = "required" if name in table.get("required", ()) else text
        yield key, " or ".join(dict.fromkeys(map(_values, kinds))), text, field.get("description", "")
        for kind in kinds:
            for inner in (kind, kind.get("items", {}), *kind.get("patternProperties", {}).values()):
                if "$ref" in inner:
                    free = "NAME." if "patternProperties" in kind else ""
                    yield from _rows(tables[inner["$ref"].rpartition("/")[2]], tables, f"{key}.{free}")


def _values(kind: Schema) -> str:
    """Range, choices or type of a key, from its JSON schema."""
    if "enum" in kind:
        return ", ".join(map(json.dumps, kind["enum"]))
    if kind.get("type") == "array":
        entries = "tables" if "$ref" in kind["items"] else ", ".join(map(json.dumps, kind["items"].get("enum", ())))
        return f"list of {entries}" if entries else "list"
    least, most, below = (_number(kind[end]) if end in kind else "" for end in ENDS)
    if most or below:
        return f"{least}..{most} {kind.get('unit', '')}".rstrip() if most else f"{least} to below {below}"
    return f"{least} or more" if least else WORDS.get(kind.get("type", "object"), "number")


def _number(number: float) -> str:
    """Short text of a number that TOML can read, such as 1e-9."""
    return f"{number:g}".replace("e+0", "e").replace("e+", "e").replace("e-0", "e-")


def with_keys(text: str) -> str:
    """Text of the README with the tables of the models between its marks."""
    tables = "\n".join(_markdown(*table) for table in key_tables().items())
    return f"{text.partition(BEGIN)[0]}{BEGIN}\n{tables}\n{END}{text.partition(END)[2]}"


def _part(table: str, rows: Rows) -> dict[str, Rows]:
    """Rows of a table of a scene."""
    if part := [row for row in rows if f"{row[0]}.".startswith(f"{table}.")]:
        return {table: part}
    known = ", ".join(row[0] for row in rows if row[1].endswith(("table", "tables")))
    raise InputError("keys", "", table, f"scene, study, engines, {known}")


def _markdown(name: str, rows: Rows) -> str:
    cells = [HEADINGS, ["---"] * len(HEADINGS), *((f"`{key}`", *rest) for key, *rest in rows)]
    return "\n".join([f"### Keys: {name}\n", *(f"| {' | '.join(row)} |".replace("  ", " ") for row in cells), ""])
