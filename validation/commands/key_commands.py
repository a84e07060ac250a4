"""Command ``keys``: tables of the keys of input files, on the screen and in ``inputs/README.md``."""

from collections.abc import Iterable, Sequence

import click

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.text_table import text_table
from validation.commands.options import command, option

README = paths.INPUTS / "README.md"
BEGIN, END = "<!-- written by: beads keys --write -->\n", "<!-- end of the tables -->\n"
HEADINGS = ("key", "values", "default", "meaning")
Rows = Iterable[Sequence[str]]


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
    from drivers.scene.model import SceneFile
    from drivers.scene.settings import key_rows

    engines = [*key_rows(Entry, "NAME.")]
    return {"scene": [*key_rows(SceneFile)], "study": [*key_rows(StudyFile)], "engines": engines}


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
