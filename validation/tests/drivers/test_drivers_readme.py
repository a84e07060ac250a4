"""Tests of ``drivers/README.md``: its command lines parse, and its keys, files and folders exist."""

import re
from dataclasses import fields

import pytest

from drivers.base.paths import ROOT
from drivers.batch.study_cases import STATES
from drivers.engines import engine_names
from drivers.engines._entries import EntryTable
from drivers.run.run_folder import RunRecord
from validation.commands.beads import BEADS
from validation.tests.helpers.readme import command_lines, parse

README = ROOT / "drivers/README.md"
TEXT = README.read_text()


def first_cells(heading: str) -> list[str]:
    """Code in the first column of the table with this heading."""
    rows = TEXT.partition(f"\n| {heading} |")[2].partition("\n\n")[0].splitlines()[2:]
    return [code for row in rows for code in re.findall(r"`([^`]+)`", row.split("|")[1])]


@pytest.mark.parametrize("line", command_lines(README))
def test_a_command_line_parses(line: str) -> None:
    parse(line)


@pytest.mark.parametrize("line", ["beads walk fig4", "beads run fig4 --fast"])
def test_an_unknown_command_or_option_does_not_parse(line: str) -> None:
    with pytest.raises(AssertionError):
        parse(line)


def test_the_keys_of_the_record_are_listed() -> None:
    assert sorted(first_cells("keys of `run.json`")) == sorted(field.name for field in fields(RunRecord))


def test_folders_and_engines_are_listed() -> None:
    folders = {path.parent.name for path in (ROOT / "drivers").glob("*/__init__.py")}
    assert {name.rstrip("/") for name in first_cells("folder")} == folders
    assert set(first_cells("engine")) == set(engine_names())


def test_the_states_of_rows_are_listed_here_and_in_the_help() -> None:
    listed = TEXT.partition("States of a row: ")[2].partition(". ")[0]
    assert tuple(re.findall(r"`([^`]+)`", listed)) == STATES
    assert (BEADS.commands["status"].params[-1].help or "").rstrip(".").endswith(", ".join(STATES))


def test_the_entry_has_all_keys() -> None:
    example = TEXT.partition("```toml\n")[2].partition("```")[0]
    assert set(re.findall(r"^(\w+) =", example, re.MULTILINE)) == set(EntryTable.model_fields)
