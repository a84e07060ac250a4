"""``inputs/README.md``: its tables of keys are those of the models, its examples can be read."""

import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import pytest

from drivers.base import paths
from drivers.batch.study import read_study
from drivers.engines import tables_in
from drivers.run.run_folder import RunRecord
from drivers.scene.read_scene import make_scene, read_scene, read_toml
from validation.commands.key_commands import README, key_tables, with_keys
from validation.tests.helpers.commands import beads

TEXT = README.read_text()
BLOCKS = re.findall(r"^```toml\n# ([^\n]*)\n(.*?)^```", TEXT, re.MULTILINE | re.DOTALL)
ROWS = {f"{file}: {key}": row for file, rows in key_tables().items() for key, *row in rows}


def test_tables_of_keys_are_up_to_date() -> None:
    """If not: ``beads keys --write``."""
    assert with_keys(TEXT) == TEXT
    assert with_keys(TEXT.replace("| `chain.count`", "| `chain.number`")) == TEXT


def test_rows_have_ranges_defaults_and_meanings_of_the_model() -> None:
    for key, row in {
        "chain.bead.from_wall": ["1..1e6", "required"],
        "striker.shape": ['"sphere", "flat"', '"sphere"'],
        "materials.NAME.poisson_ratio": ["0 to below 0.5", "required"],
        "run.record": ['list of "forces", "state"', '["forces"]'],
    }.items():
        assert ROWS[f"scene: {key}"][:2] == row
    assert [key for key, (values, _, meaning) in ROWS.items() if not values or not meaning] == []


def test_the_command_lists_one_table() -> None:
    lines = beads("keys", "chain.pattern").stdout.splitlines()
    assert [line.split()[0] for line in lines[2:]] == [
        key[7:] for key in ROWS if key.startswith("scene: chain.pattern")
    ]
    refused = beads("keys", "chains")
    assert (refused.returncode, refused.stderr[:35]) == (2, "keys: found chains; allowed: scene,")


def test_the_command_explains_the_fields_of_a_record_beside_the_table_of_that_name() -> None:
    explained = {line.split()[0]: line.split()[-1] for line in beads("keys", "run").stdout.splitlines()}
    assert {"run.time_step", *(field.name for field in fields(RunRecord))} < {*explained}
    assert explained["commit"] == "checkout"


def read_fragment(path: Path) -> object:
    """Read part of a scene file; the other tables are those of a shipped scene."""
    tables = read_toml(paths.SCENES / "example-measured.toml") | read_toml(path)
    return make_scene(tables, "example", "README", paths.SCENES).measured


READERS: dict[str, Callable[[Path], object]] = {
    "steel.toml": read_scene,
    "in a scene file": read_fragment,
    "my-study.toml": lambda path: [read_study(path).case(number) for number in range(1, read_study(path).count + 1)],
    "engines.toml": lambda path: [*tables_in(path)],
}


@pytest.mark.parametrize(("name", "block"), BLOCKS)
def test_examples_can_be_read(name: str, block: str, tmp_path: Path) -> None:
    path = tmp_path / Path(name.replace(" ", "-")).with_suffix(".toml").name
    path.write_text(block)
    assert READERS[name](path)
