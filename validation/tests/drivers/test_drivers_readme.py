"""Tests of ``drivers/README.md``: its command lines parse, its keys, files and folders exist, its scripts run."""

import re
import sys
from contextlib import closing
from dataclasses import MISSING, fields, replace
from importlib import import_module
from operator import attrgetter
from pathlib import Path

import pytest

from drivers.base.decks import Deck, render
from drivers.base.paths import ROOT
from drivers.batch.study_cases import STATES
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import digest_of
from drivers.engines import Engine, engine_names, load_engine
from drivers.engines._entries import EntryTable
from drivers.run.guard import checked_trace
from drivers.run.run_folder import RunRecord
from drivers.run.session import Session
from validation.commands.beads import BEADS
from validation.tests.helpers.readme import command_lines, parse
from validation.tests.helpers.scenes import case_of

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


def test_the_fields_that_an_adapter_needs_are_listed() -> None:
    listed = {code.partition("(")[0] for code in first_cells("`Engine` (`drivers.engines`)")}
    every = {field.name: field for field in fields(Engine)}
    assert listed < set(every)
    assert {name for name, field in every.items() if field.default is field.default_factory is MISSING} < listed


def test_names_of_a_case_and_of_modules_exist() -> None:
    case = case_of("fig4")
    rows = TEXT.partition("| `case` (`drivers.chain.case`) |")[2].partition("\n\n")[0]
    for name in re.findall(r"`((?:chain|scene)\.\w+)", rows):
        attrgetter(name)(case)
    for name in first_cells("`case` (`drivers.chain.case`)"):
        attrgetter(name.partition("(")[0])(case)
    section = TEXT.partition("## To add an engine")[2]
    named = re.findall(r"`(\w+)[^`]*` \(`(drivers[\w.]+)`\)", section)
    assert len(named) > 5
    for name, module in named:
        assert name == "case" or hasattr(import_module(module), name), (module, name)
    others = {"engines": ("IN_OVERLAPS",), "engines._raw_output": ("read_arrays", "read_dump", "contact_forces")}
    for module, names in others.items():
        for name in names:
            assert f"`{name}" in section
            assert hasattr(import_module(f"drivers.{module}"), name)


def test_the_script_serves_a_code(tmp_path: Path) -> None:
    case, verlet = case_of("fig4", "run.duration=20 us"), load_engine("verlet")
    deck = verlet.render(case)
    server = Deck({"serve.sh": render("serve.sh")}, ("sh", "serve.sh", *deck.command), raw=())
    broken = replace(deck, files=dict.fromkeys(deck.files, "{"))
    with closing(Session(replace(verlet, server=server), (sys.executable,), tmp_path)) as session:
        for each, code in ((deck, 0), (deck, 0), (broken, 1), (deck, 0)):
            outcome = session.run(each, 60.0)
            assert (outcome.code, session.ended) == (code, code == 1)
            if not code:
                trace = checked_trace(case, verlet, outcome, session.case)
                assert digest_of(trace) == digest_of(verlet_of(case))
