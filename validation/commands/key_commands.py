"""Commands on the files and engines that there are: ``scenes``, ``keys``, ``engine``, ``wave``."""

import json
import platform
import re
import shlex
import tomllib
from collections.abc import Iterator
from inspect import cleandoc
from math import inf
from pathlib import Path
from typing import Any

from pydantic import BaseModel, TypeAdapter

from drivers.base import paths
from drivers.base.cache import store
from drivers.base.errors import InputError, RunError
from drivers.base.processes import git, local_changes
from drivers.base.terminal import text_table
from drivers.batch.study import StudyFile
from drivers.engines import Entry, engines_again, load_engine
from drivers.run.build import build_of
from drivers.run.run_folder import RECORD, RunRecord
from drivers.scene.model import Scene
from drivers.scene.read_scene import read_toml
from postproc.read import observables
from validation.accuracy.costs import entry_of, kit_key, measured_cost
from validation.reference.travelling_wave import constants, solve_travelling_wave

README = paths.INPUTS / "README.md"
BEGIN, END = "<!-- written by: beads keys --write -->\n", "<!-- end of the tables -->\n"
HEADINGS = ("key", "values", "default", "meaning")
ENDS = ("minimum", "maximum", "exclusiveMaximum")
WORDS = {"boolean": "true or false", "string": "text", "object": "table"}  # by type of a JSON schema
Schema = dict[str, Any]
Rows = list[tuple[str, ...]]
INPUTS: dict[str, tuple[type[BaseModel], str]] = {  # model of each file, and what its keys begin with
    "scene": (Scene, ""),
    "study": (StudyFile, ""),
    "engines": (Entry, "NAME."),
}


def scenes() -> None:
    """List the shipped scenes, studies and materials.

    Example:
      beads scenes
    """
    listed = {
        what: {path.stem: read_toml(path).get("title", "") for path in sorted(home.glob("*.toml"))}
        for what, home in (("scenes", paths.SCENES), ("studies", paths.STUDIES))
    }
    listed["materials"] = {name: material.get("source", "") for name, material in read_toml(paths.MATERIALS).items()}
    for what, texts in listed.items():
        print(f"{what}:", *(f"  {line}" for line in text_table(texts.items())), sep="\n")


def keys(write: bool, table: str = "") -> None:
    """List keys of scenes and studies, with units and ranges.

    Examples:
      beads keys chain
      beads keys study
    """
    if write:
        README.write_text(with_keys(README.read_text()))
        return
    files = key_tables() | {Path(RECORD).stem: rows_of_record()}
    found = dict[str, Rows]()
    for file, rows in files.items():
        found[file] = [row for row in rows if table in ("", file) or f"{row[0]}.".startswith(f"{table}.")]
    if not any(found.values()):
        tables = (row[0] for rows in files.values() for row in rows if row[1].endswith(("table", "tables")))
        raise InputError("keys", "", table, ", ".join([*files, *tables]))
    for file in filter(found.get, found):
        print(f"{file}:", *(f"  {line}" for line in text_table([HEADINGS, *found[file]])), sep="\n")


def key_tables() -> dict[str, Rows]:
    """Rows of the keys of each file of the inputs, by name."""
    schemas = {name: (model.model_json_schema(), prefix) for name, (model, prefix) in INPUTS.items()}
    return {name: [*_rows(schema, schema.get("$defs", {}), prefix)] for name, (schema, prefix) in schemas.items()}


def rows_of_record() -> Rows:
    """Rows of the fields of ``run.json``, with their meanings in the docstring of their class."""
    text = cleandoc(RunRecord.__doc__ or "").partition("Attributes:\n")[2]
    meanings = dict(re.findall(r"^    (\w+): ((?:.|\n {8})*)\.$", text, re.MULTILINE))
    rows = _rows(TypeAdapter(RunRecord).json_schema(), {}, "")
    return [(key, values, "", " ".join(meanings[key].split())) for key, values, *_ in rows]


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
    lines = list[str]()
    for name, rows in key_tables().items():
        cells = [HEADINGS, ["---"] * len(HEADINGS), *((f"`{key}`", *rest) for key, *rest in rows)]
        lines += [f"### Keys: {name}\n", *(f"| {' | '.join(row)} |".replace("  ", " ") for row in cells), ""]
    return "\n".join([f"{text.partition(BEGIN)[0]}{BEGIN}", *lines, f"{END}{text.partition(END)[2]}"])


def version() -> None:
    """Print a line with the version of the project and of Python, and the commit."""
    project = tomllib.loads((paths.ROOT / "pyproject.toml").read_text())["project"]
    changes = " and changes" * local_changes()
    commit = git("rev-parse", "--short=10", "HEAD") or "unknown"
    print(f"{project['name']} {project['version']}, commit {commit}{changes}, Python {platform.python_version()}")


def definitions() -> None:
    """Print the definitions of all observables."""
    rows = [(f"{each.pattern}{each.ending}", each.definition) for each in observables.OBSERVABLES]
    print(observables.__doc__, *text_table(rows), sep="\n")


def engine(name: str, tests: str, all_tests: bool, results: Path) -> int:
    """Test an adapter or a build of a code, in a minute.

    Tests that a build passed are not run again; --all runs all the others, however long they take.

    Examples:
      beads engine verlet
      beads engine liggghts-old --engines mine.toml
      beads engine mine --only server
    """
    tested = load_engine(name)
    if tested.find() is None:
        raise RunError(f"{name}: {tested.absence}")
    import pytest  # takes as long to load as all the rest

    from validation.tests.engine.kit import MINUTE_S, Kit

    arguments = ["-rs", "--tb=short", "--capture=sys", "-W", "ignore::pytest.PytestConfigWarning", "--engine", name]
    arguments += ["--rootdir", str(paths.ROOT), "-c", str(paths.ROOT / "pyproject.toml"), "-k", tests]
    if results != paths.RESULTS:
        arguments += ["--junitxml", str(results / f"engine-{name}.xml")]
    kit = Kit(name, inf if all_tests else MINUTE_S, again=bool(tests))
    code = int(pytest.main([*arguments, str(paths.ROOT / "validation/tests/engine")], plugins=[kit]))
    if tests and code in (pytest.ExitCode.NO_TESTS_COLLECTED, pytest.ExitCode.USAGE_ERROR):
        raise InputError("--only", "", tests, "words in the names of tests, such as server, or 'scene and not fig4'")
    again = f"{shlex.join(['beads', 'engine', name, *engines_again()])} goes on"
    if code == pytest.ExitCode.INTERRUPTED and not kit.over:
        raise KeyboardInterrupt(again)
    passed = f"passed, or skipped for a reason, {len(kit.passed)} now, {len(kit.before)} before"
    left = f"; left: {kit.left}: {again}, with --all to the end" if kit.left else ""
    print(f"\n{name}: failed {len(kit.failed)}; {passed}{left}")
    if kit.failed or not tests:
        store(kit_key(name), not kit.failed)
    if not kit.failed and not kit.left and not tests:
        cost = measured_cost(tested, build_of(tested))
        where = f"as an entry of {paths.shown(paths.COSTS)}; for own engines no file has to be edited"
        print(f"measured cost, cached for plans and batches ({where}):", *entry_of(name, cost), sep="\n")
    return int(bool(kit.failed))


def wave() -> None:
    """Print constants of the discrete chain's solitary wave.

    Example:
      beads wave
    """
    print("\n".join(constants(solve_travelling_wave())))
