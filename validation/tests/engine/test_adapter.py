"""The adapter of an engine: interface, build and deck."""

import os
import re
import shlex
import subprocess
import sys
from dataclasses import fields, replace
from inspect import isfunction, unwrap
from pathlib import Path
from shutil import which

import pytest

from drivers.base.processes import UNKNOWN_VERSION, scrubbed_environment
from drivers.chain.case import SIDEWAYS, STRAIGHT
from drivers.chain.trace import digest_of
from drivers.engines import EXACT, IN_HEIGHTS, IN_OVERLAPS
from drivers.run.build import build_of
from validation.reference.tube import LAWS
from validation.tests.engine.candidate import Candidate, case_with, kit

OTHER_PROGRAM = "true"  # a program that prints no version


def test_interface(candidate: Candidate) -> None:
    """The interface is complete, its values are known to the project, and its functions are documented."""
    engine, deck = candidate.engine, candidate.deck
    assert engine.how_to_get
    assert engine.program in deck.command
    assert engine.program in engine.server.command
    assert re.compile(engine.loop_pattern).groups, "loop_pattern has no group"
    assert engine.scheme in (IN_HEIGHTS, IN_OVERLAPS, EXACT)
    assert engine.shear in LAWS
    assert engine.models <= STRAIGHT | SIDEWAYS
    assert deck.files
    assert deck.raw
    assert not {*deck.raw} & {*deck.files}, "raw output is among the deck's files"
    assert unwrap(engine.render).__globals__["__doc__"]
    functions = {field.name: getattr(engine, field.name) for field in fields(engine)}
    documented = {name: bool(each.__doc__) for name, each in functions.items() if isfunction(each)}
    assert {name for name, has in documented.items() if not has and functions[name].__name__ != "<lambda>"} == set()


def test_version(candidate: Candidate) -> None:
    """The version is one line, printed by the program itself, and the build has the same identity each time."""
    engine, build = candidate.engine, candidate.build
    assert build.version not in ("", UNKNOWN_VERSION)
    assert len(build.version.splitlines()) == 1
    if engine.in_repository:
        assert engine.version(build.command) == build.version
        return
    assert build_of(engine).identity == build.identity
    other = engine.version((which(OTHER_PROGRAM) or OTHER_PROGRAM,))
    assert other != build.version, f"the version does not come from the command: {OTHER_PROGRAM} gives the same"


def test_deck(candidate: Candidate, monkeypatch: pytest.MonkeyPatch) -> None:
    """The deck is unchanged by settings without effect on numbers, and changed by all other settings."""
    engine, deck, base = candidate.engine, candidate.deck, candidate.base
    renamed = base.scene.model_copy(update={"name": "another", "file": "another.toml", "title": "another"})
    same = {setting: case_with(setting) for setting in kit()["same"]} | {"scene.name": replace(base, scene=renamed)}
    assert {key for key, case in same.items() if engine.render(case).sha256 != deck.sha256} == set()
    text = "\n".join((*deck.files.values(), *deck.command))
    places = (str(Path.cwd()), str(candidate.folder), *(word for word in candidate.build.command if "/" in word))
    assert not [place for place in places if len(place) > 1 and place in text], "the deck contains a folder"
    monkeypatch.chdir(candidate.folder)
    monkeypatch.setenv("PATH", str(candidate.folder))
    assert engine.render(base).sha256 == deck.sha256, "the deck depends on the folder or on PATH"
    monkeypatch.undo()
    digests = {deck.sha256: "no change"}
    for name, case in candidate.changed().items():
        digest = engine.render(case).sha256
        assert digest not in digests, f"the deck for a change of {name} is the same as for {digests[digest]}"
        digests[digest] = name


def test_deck_by_hand(candidate: Candidate) -> None:
    """The command in the first line of the deck, run by a shell in an empty folder, gives identical results."""
    engine, deck = candidate.engine, candidate.deck
    _, trace = candidate.alone
    name, text = next(iter(deck.files.items()))
    assert " ".join(deck.command) in text.partition("\n")[0], f"the first line of {name} is not its command"
    folder = candidate.folder / "by-hand"
    folder.mkdir()
    written = engine.by_hand(deck)
    written.write(folder)
    environment = scrubbed_environment() | engine.environment
    beside = str(Path(sys.executable).parent)  # programs are found as by ``find_command``
    places = (beside, environment["PATH"]) if engine.in_repository else (environment["PATH"], beside)
    environment["PATH"] = os.pathsep.join(places)
    with open(folder / "stdout.txt", "w") as out, open(folder / "stderr.txt", "w") as err:
        ended = subprocess.run(
            shlex.join(written.command), shell=True, cwd=folder, env=environment, stdout=out, stderr=err,
            check=False, timeout=100,
        )  # fmt: skip
    assert ended.returncode == 0, (folder / "stderr.txt").read_text()[-200:]
    assert digest_of(candidate.read(candidate.base, folder)) == digest_of(trace)
