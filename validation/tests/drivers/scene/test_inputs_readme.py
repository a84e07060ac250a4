"""``inputs/README.md`` lists all keys, with correct units, ranges and defaults, and with examples that can be read."""

import re
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import pytest
from pydantic import BaseModel, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from drivers.base import paths
from drivers.base.messages import validate
from drivers.base.tolerances import Tolerance
from drivers.batch.axes import Axis
from drivers.batch.study import StudyFile, read_study
from drivers.engines import _entries
from drivers.scene import model
from drivers.scene.drive_table import DriveTable
from drivers.scene.part import Part
from drivers.scene.read_scene import make_scene, read_entries, read_scene, read_toml
from drivers.scene.settings import unit_of
from validation.accuracy.costs import Cost
from validation.calibration.calibration_file import CalibrationFile, Range
from validation.claims.cases import MEASURES, Independent, read_independent
from validation.claims.claim import ClaimsFile, read_claims
from validation.elements.switches import Elements
from validation.stability.extremes import Extreme
from validation.tests.engine.candidate import case_with, kit
from validation.tests.helpers.readme import command_lines, parse

README = paths.INPUTS / "README.md"
TEXT = README.read_text()
Table = list[dict[str, str]]
# by heading of a table of keys: path of the table in a scene, and model
SCENE_TABLES: dict[str, tuple[str, type[BaseModel]]] = {
    "Top level": ("", model.SceneFile),
    "`[chain]`": ("chain", model.ChainTable),
    "`chain.sensors`": ("chain.sensors.0", model.Sensor),
    "`[[chain.pattern]]`": ("chain.pattern.0", model.Member),
    "`[[chain.bead]]`": ("chain.bead.0", model.Bead),
    "`[striker]`": ("striker", model.Striker),
    "`[wall]`": ("wall", model.Wall),
    "`[tube]`": ("tube", model.Tube),
    "`[contact]`": ("contact", model.Contact),
    "`[drive]`": ("drive", DriveTable),
    "`[sensor]`": ("sensor", model.Gauge),
    "`[materials.NAME]`": ("materials.ptfe", model.Material),
    "`[run]`": ("run", model.Run),
    "`[[measured]]`": ("measured.0", model.MeasuredEntry),
}


def sections() -> dict[str, str]:
    """Text of each section by heading, without code blocks."""
    parts = re.split(r"^##+ (.*)\n", re.sub(r"^```.*?^```\n", "", TEXT, flags=re.MULTILINE | re.DOTALL), flags=re.M)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def tables(text: str) -> list[Table]:
    """Tables of a text: lists of rows, each with cells by column."""
    found: list[Table] = []
    for block in re.findall(r"(?:^\|.*\|\n)+", text, re.MULTILINE):
        head, _, *rows = [[cell.strip() for cell in line[1:-1].split("|")] for line in block.splitlines()]
        found.append([dict(zip(head, row, strict=True)) for row in rows])
    return found


def literal(cell: str) -> Any:
    """Value of a cell if the cell is one TOML value in backticks; None for other text."""
    match = re.fullmatch(r"`([^`]*)`", cell)
    try:
        return tomllib.loads(f"x = {match[1]}")["x"] if match else None
    except tomllib.TOMLDecodeError:
        return None


def adapter(field: FieldInfo) -> TypeAdapter[Any]:
    """Validator of a single key."""
    kind: Any = field.annotation
    return TypeAdapter(Annotated[kind, *field.metadata] if field.metadata else kind)


def accepts(field: FieldInfo, value: object) -> bool:
    """True if the key may have the value, given as read from TOML."""
    try:
        adapter(field).validate_python(tuple(value) if isinstance(value, list) else value)
    except ValidationError:
        return False
    return True


def name_of(name: str, field: FieldInfo) -> str:
    return field.alias or name


SECTIONS = sections()
ROWS = [
    pytest.param(path, kind, row, id=f"{path}.{row['key'].strip('`')}")
    for heading, (path, kind) in SCENE_TABLES.items()
    for row in tables(SECTIONS[heading])[0]
]


@pytest.mark.parametrize("heading", SCENE_TABLES)
def test_every_key_of_a_scene_has_a_row(heading: str) -> None:
    _, kind = SCENE_TABLES[heading]
    (rows,) = tables(SECTIONS[heading])
    assert [row["key"].strip("`") for row in rows] == [name_of(*each) for each in kind.model_fields.items()]


@pytest.mark.parametrize(("path", "kind", "row"), ROWS)
def test_rows_agree_with_the_model(path: str, kind: type[BaseModel], row: dict[str, str]) -> None:
    key = row["key"].strip("`")
    field = kind.model_fields[key]
    assert row["unit"] == unit_of(f"{path}.{key}".strip("."))
    assert (row["default"] == "required") == field.is_required()
    value = literal(row["default"])
    if value is not None:
        read = adapter(field).validate_python(tuple(value) if isinstance(value, list) else value)
        assert read == field.get_default(call_default_factory=True)
    elif not field.is_required() and not issubclass(type(field.default), Part):
        assert not field.get_default(call_default_factory=True)
    example = literal(row["example"])
    assert example is not None or "table" in row["range"]
    assert example is None or accepts(field, example)


@pytest.mark.parametrize(("path", "kind", "row"), ROWS)
def test_ranges_agree_with_the_model(path: str, kind: type[BaseModel], row: dict[str, str]) -> None:
    field, unit = kind.model_fields[row["key"].strip("`")], row["unit"]
    values = re.findall(r'`("\w+")`', row["range"])
    if values and " or " in row["range"]:
        assert all(accepts(field, value.strip('"')) for value in values)
        assert not accepts(field, "other")
    span = re.fullmatch(r"(0, )?(\S+) (?:to (below )?([\d.e+-]+)|or more)(, both excluded)?", row["range"])
    if not span:
        assert re.search("text|name|true or false|table|number with unit|list with|or ", row["range"]), row["range"]
        return
    zero, low, below, high, excluded = span.groups()

    def written(number: float | int) -> Any:
        return f"{number!r} {unit}" if unit else number

    def number(text: str) -> float | int:
        return float(text) if "e" in text or "." in text or unit else int(text)

    first, last = number(low), number(high or "1")
    assert accepts(field, written(first)) == (not excluded)
    assert not accepts(field, written(-1.0 if first == 0 else first * (0.99 if first > 0 else 1.01)))
    if zero:
        assert accepts(field, written(0.0))
    if high:
        assert accepts(field, written(last)) == (not below and not excluded)
        assert not accepts(field, written(last + 1 if isinstance(last, int) else last * 1.01))


@pytest.mark.parametrize(("place", "kind"), [(0, StudyFile), (1, Axis)])
def test_every_key_of_a_study_has_a_row(place: int, kind: type[BaseModel]) -> None:
    rows = tables(SECTIONS["Study files"])[place]
    assert [row["key"].strip("`") for row in rows] == [name_of(*each) for each in kind.model_fields.items()]
    for row, field in zip(rows, kind.model_fields.values(), strict=True):
        assert (row["default"] == "required") == field.is_required()
        value, example = literal(row["default"]), literal(row["example"])
        if value is not None:
            assert (tuple(value) if isinstance(value, list) else value) == field.get_default(call_default_factory=True)
        assert row["key"] == "`axis`" or accepts(field, example)


def keys(kind: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Keys of a model and of the models in it, joined by dots; ``KEY`` replaces a free name."""
    for name, field in kind.model_fields.items():
        inner = [each for each in parts(field.annotation) if isinstance(each, type) and issubclass(each, BaseModel)]
        here = f"{prefix}{name_of(name, field)}"
        if inner:
            free_name = "KEY." if any(get_origin(each) is dict for each in parts(field.annotation)) else ""
            yield from keys(inner[0], f"{here}.{free_name}")
        else:
            yield here


def parts(annotation: Any) -> Iterator[Any]:
    """Annotation and all parts of which it is composed."""
    yield annotation
    for each in get_args(annotation):
        yield from parts(each)


def key_cells(heading: str) -> set[str]:
    """Keys in all columns ``key`` of the tables of a section."""
    rows = [row for table in tables(SECTIONS[heading]) for row in table]
    return {key for row in rows for key in re.findall(r"`([^`]+)`", row.get("key", ""))}


def test_every_key_of_the_other_files_has_a_row() -> None:
    assert key_cells("Engines") == {*_entries.EntryTable.model_fields}
    assert key_cells("Cases beyond the paper") == {*keys(Independent, "case.")}
    claims = {key for key in keys(ClaimsFile) if not key.startswith("readings.")}
    assert key_cells("The paper") == claims | {"claim.readings", "claim.shared_readings"}
    ranges = {f"range.KEY.{key}" for key in Range.model_fields}
    fits = {key for key in keys(CalibrationFile) if not key.startswith("range")}
    assert key_cells("Calibration") == ranges | fits
    rows = tables(SECTIONS["Elements, extremes and kit"])[0]
    file, listed = "", dict[str, set[str]]()
    for row in rows:
        file = row["file"].strip("`") or file
        listed.setdefault(file, set()).update(re.findall(r"`([^`]+)`", row["key"]))
    sides = {"element.without", "element.with"}
    elements = {key for key in keys(Elements) if not key.startswith(tuple(sides))} | sides
    assert listed["elements.toml"] == elements
    assert listed["extremes.toml"] == {*keys(Extreme, "extreme.")}
    assert listed["kit.toml"] == {*kit()} - {"change", "variant"} | {"change.NAME"} | {
        f"variant.{key}" for each in kit()["variant"] for key in each
    }
    assert set(re.findall(r"`([^`]+)`", SECTIONS["Costs"])) >= {*Cost.__dataclass_fields__}
    assert all(f"`{name}`" in SECTIONS["Cases beyond the paper"] for name in MEASURES)


def test_every_kind_of_tolerance_is_listed() -> None:
    named = {kind for row in tables(SECTIONS["Tolerances"])[0] for kind in re.findall(r"`(\w+)`", row["kind"])}
    assert named == {*read_toml(paths.TOLERANCES)}


@pytest.mark.parametrize(("heading", "home"), [("Shipped scenes", paths.SCENES), ("Study files", paths.STUDIES)])
def test_every_shipped_file_is_listed(heading: str, home: Path) -> None:
    rows = tables(SECTIONS[heading])[-1]
    names = [name for row in rows for name in re.findall(r"`([\w-]+)`", next(iter(row.values())))]
    assert sorted(names) == sorted(path.stem for path in home.glob("*.toml"))


def test_every_file_is_in_the_first_table() -> None:
    (rows,) = [table for table in tables(TEXT) if "contents" in table[0]]
    named = {name.rstrip("/") for row in rows for name in re.findall(r"`([\w./]+)`", row["file or folder"])}
    assert named == {path.name for path in paths.INPUTS.iterdir()} - {"README.md"}


def read_as(kind: type[BaseModel]) -> Callable[[Path], object]:
    """Function that reads a whole file with a model."""
    return lambda path: validate(kind, read_toml(path), path.name)


def read_fragment(path: Path) -> None:
    """Read part of a scene file; the other tables come from the shipped scene ``example-measured``."""
    tables = read_toml(paths.SCENES / "example-measured.toml") | read_toml(path)
    assert make_scene(tables, read_toml(paths.MATERIALS), "example", "README", paths.SCENES).measured


READERS: dict[str, Callable[[Path], object]] = {
    "steel.toml": read_scene,
    "in a scene file": read_fragment,
    "inputs/materials.toml": lambda path: [model.Material(**each) for each in read_toml(path).values()],
    "my-study.toml": lambda path: [read_study(path).case(number) for number in range(1, read_study(path).count + 1)],
    "engines.toml": lambda path: [*_entries._read(path)],
    "inputs/tolerances.toml": lambda path: [
        Tolerance(**limit) for kind in read_toml(path).values() for limit in kind.values()
    ],
    "my-cases.toml": read_independent,
    "inputs/paper/claims.toml": read_claims,
    "inputs/calibration.toml": read_as(CalibrationFile),
    "inputs/elements.toml": read_as(Elements),
    "inputs/extremes.toml": lambda path: read_entries(path, "extreme", Extreme),
    "inputs/kit.toml": lambda path: [case_with(*each["set"]) for each in read_toml(path)["variant"]],
    "inputs/costs.toml": lambda path: [Cost(**each) for each in read_toml(path).values()],
}
BLOCKS = re.findall(r"^```toml\n# ([^\n]*)\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)


def test_every_block_names_its_file() -> None:
    assert len(BLOCKS) == TEXT.count("```toml")
    assert {name for name, _ in BLOCKS} == {*READERS}


@pytest.mark.parametrize(("name", "block"), BLOCKS)
def test_examples_can_be_read(name: str, block: str, tmp_path: Path) -> None:
    path = tmp_path / Path(name.replace(" ", "-")).with_suffix(".toml").name
    path.write_text(block)
    READERS[name](path)


@pytest.mark.parametrize("line", command_lines(README))
def test_commands_parse(line: str) -> None:
    settings = getattr(parse(line), "settings", None) or []
    if "run fig4" in line:
        assert read_scene("fig4", tuple(settings))
