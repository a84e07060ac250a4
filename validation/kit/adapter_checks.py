"""Checks of an adapter that need at most one run: interface, build, deck."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import chdir
from dataclasses import fields
from importlib import import_module
from inspect import isfunction
from pathlib import Path
from shutil import which

from drivers.base.errors import RunError
from drivers.base.processes import UNKNOWN_VERSION, scrubbed_environment
from drivers.chain.elements import SIDEWAYS, STRAIGHT
from drivers.chain.trace import digest_of
from drivers.engines import EXACT, IN_HEIGHTS, IN_OVERLAPS, INCREMENTAL, TOTAL
from drivers.run.build import build_of, files_of
from validation.kit.candidate import Candidate, Measured, case_with, kit_file

OTHER_PROGRAM = ("true",)  # a program that prints no version


def _none(problems: list[str], words: str) -> Measured:
    """Result of a check that allows no problem; ``words`` describe the result without problems."""
    return Measured(len(problems), 0, "; ".join(problems) or words)


def interface(candidate: Candidate) -> Iterator[Measured]:
    """The interface is complete, its values are known to the project, and its functions are documented."""
    engine, deck = candidate.engine, candidate.deck
    module = import_module(engine.render.__module__)
    functions = {
        field.name: function for field in fields(engine) if isfunction(function := getattr(engine, field.name))
    }
    own = {name: function for name, function in functions.items() if function.__name__ != "<lambda>"}
    wrong = {
        "how_to_get is empty": not engine.how_to_get,
        "program is missing in the deck's command": engine.program not in deck.command,
        "program is missing in the server's command": engine.program not in engine.server.command,
        "loop_pattern has no group": not re.compile(engine.loop_pattern).groups,
        f'scheme is "{engine.scheme}"': engine.scheme not in (IN_HEIGHTS, IN_OVERLAPS, EXACT),
        f'shear is "{engine.shear}"': engine.shear not in (TOTAL, INCREMENTAL),
        f"models has {', '.join(engine.models - STRAIGHT - SIDEWAYS)}": not engine.models <= STRAIGHT | SIDEWAYS,
        "the deck has no file": not deck.files,
        "the deck names no raw output": not deck.raw,
        "raw output is among the deck's files": bool({*deck.raw} & {*deck.files}),
        "the adapter has no docstring": not module.__doc__,
    }
    wrong |= {f"{name} has no docstring": not function.__doc__ for name, function in own.items()}
    words = f"{len(fields(engine))} fields, {len(own)} documented functions"
    yield _none([problem for problem, found in wrong.items() if found], words)


def version(candidate: Candidate) -> Iterator[Measured]:
    """The version is one line, printed by the program itself, and the build has the same identity each time."""
    engine, build = candidate.engine, candidate.build
    if engine.in_repository:
        yield _none(
            [] if engine.version_of(build.command) == build.version else ["another version each time"], build.version
        )
        return
    home = candidate.folder / "build"
    again, files = build_of(engine, home), files_of(home)
    other = which(OTHER_PROGRAM[0])
    version_of_other = engine.version_of((other or OTHER_PROGRAM[0],))
    wrong = {
        "no version": build.version in ("", UNKNOWN_VERSION),
        "the version has several lines": len(build.version.splitlines()) > 1,
        "the build has another identity each time": again.identity != build.identity,
        f"the version does not come from the command: {OTHER_PROGRAM[0]} gives the same": version_of_other
        == build.version,
    }
    words = f"{build.version}; {len(files)} files of program and libraries, SHA-256 {build.sha256[:12]}"
    yield _none([problem for problem, found in wrong.items() if found], words)


def deck_of_physics(candidate: Candidate) -> Iterator[Measured]:
    """The deck is unchanged by settings without effect on numbers, and changed by all other settings."""
    engine, deck, base = candidate.engine, candidate.deck, candidate.base
    renamed = base.scene.model_copy(update={"name": "another", "file": "another.toml", "title": "another"})
    same = {setting.partition("=")[0]: case_with(setting) for setting in kit_file().same}
    same["scene.name"] = type(base)(renamed, base.chain, base.elements)
    problems = [f"{key} changes the deck" for key, case in same.items() if engine.render(case).sha256 != deck.sha256]
    before = os.environ["PATH"]
    try:
        with chdir(candidate.folder):
            os.environ["PATH"] = str(candidate.folder)
            if engine.render(base).sha256 != deck.sha256:
                problems.append("the deck depends on the folder or on PATH")
    finally:
        os.environ["PATH"] = before
    text = "\n".join((*deck.files.values(), *deck.command))
    places = (str(Path.cwd()), str(candidate.folder), *(word for word in candidate.build.command if "/" in word))
    problems += [f"the deck contains {place}" for place in places if len(place) > 1 and place in text]
    changed = {name: engine.render(case).sha256 for name, case in candidate.changed().items()}
    seen = {deck.sha256: "no change"}
    for name, digest in changed.items():
        if digest in seen:
            problems.append(f"the deck for a change of {name} is the same as for {seen[digest]}")
        seen.setdefault(digest, name)
    words = f"unchanged by {len(same)} other names and gauges, changed by each of {len(changed)} changes of physics"
    yield _none(problems, words)


def deck_by_hand(candidate: Candidate) -> Iterator[Measured]:
    """The command in the first line of the deck, run by a shell in an empty folder, gives identical results."""
    engine, deck = candidate.engine, candidate.deck
    _, trace = candidate.alone
    name, text = next(iter(deck.files.items()))
    if " ".join(deck.command) not in text.partition("\n")[0]:
        raise RunError(f"the first line of {name} is not its command, {' '.join(deck.command)}")
    folder, command = candidate.folder / "by-hand", engine.command_by_hand(deck)
    folder.mkdir()
    engine.deck_by_hand(deck).write(folder)
    environment = scrubbed_environment() | engine.environment
    beside = str(Path(sys.executable).parent)  # programs are found as by ``find_command``
    places = (beside, environment["PATH"]) if engine.in_repository else (environment["PATH"], beside)
    environment["PATH"] = ":".join(places)
    with open(folder / "stdout.txt", "w") as out, open(folder / "stderr.txt", "w") as err:
        ended = subprocess.run(
            command, shell=True, cwd=folder, env=environment, stdout=out, stderr=err, check=False, timeout=100
        )
    if ended.returncode:
        raise RunError(f"exit code {ended.returncode}: {(folder / 'stderr.txt').read_text()[-200:]}")
    same = digest_of(candidate.read(candidate.base, folder)) == digest_of(trace)
    yield _none([] if same else ["other results than in a run"], f"identical to a run, bit for bit: {command}")
