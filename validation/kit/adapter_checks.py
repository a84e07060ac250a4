"""Checks of an adapter that need no run but one: its interface, its build, its deck."""

import os
import re
import shlex
import subprocess
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

OTHER_PROGRAM = ("true",)  # a program that says nothing of a version


def _none(problems: list[str], words: str) -> Measured:
    """No problem is allowed; words for none."""
    return Measured(len(problems), 0, "; ".join(problems) or words)


def interface(candidate: Candidate) -> Iterator[Measured]:
    """The interface is complete, its values are those that the project knows, and its functions are documented."""
    engine, deck = candidate.engine, candidate.deck
    module = import_module(engine.render.__module__)
    functions = {
        field.name: function for field in fields(engine) if isfunction(function := getattr(engine, field.name))
    }
    own = {name: function for name, function in functions.items() if function.__name__ != "<lambda>"}
    wrong = {
        "how_to_get is empty": not engine.how_to_get,
        "program is no word of the deck's command": engine.program not in deck.command,
        "program is no word of the server's command": engine.program not in engine.server.command,
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
    words = f"{len(fields(engine))} fields, {len(own)} functions documented"
    yield _none([problem for problem, there in wrong.items() if there], words)


def version(candidate: Candidate) -> Iterator[Measured]:
    """The version line is one line, asked of the program that is found, and the build is the same each time."""
    engine, build = candidate.engine, candidate.build
    if engine.in_repository:
        yield _none(
            [] if engine.version_of(build.command) == build.version else ["another one each time"], build.version
        )
        return
    home = candidate.folder / "build"
    again, files = build_of(engine, home), files_of(home)
    other = which(OTHER_PROGRAM[0])
    told = engine.version_of((other or OTHER_PROGRAM[0],))
    wrong = {
        "it gives no version": build.version in ("", UNKNOWN_VERSION),
        "the version is more than a line": len(build.version.splitlines()) > 1,
        "the build has another identity each time": again.identity != build.identity,
        f"{OTHER_PROGRAM[0]} has this version, too: it is not asked of the command": told == build.version,
    }
    words = f"{build.version}; {len(files)} files, {build.sha256[:12]}"
    yield _none([problem for problem, there in wrong.items() if there], words)


def deck_of_physics(candidate: Candidate) -> Iterator[Measured]:
    """The deck is the same whatever changes no number, and another for whatever does."""
    engine, deck, base = candidate.engine, candidate.deck, candidate.base
    renamed = base.scene.model_copy(update={"name": "another", "file": "another.toml", "title": "another"})
    same = {setting.partition("=")[0]: case_with(setting) for setting in kit_file().same}
    same["scene.name"] = type(base)(renamed, base.chain, base.elements)
    problems = [f"{key} changes it" for key, case in same.items() if engine.render(case).sha256 != deck.sha256]
    before = os.environ["PATH"]
    try:
        with chdir(candidate.folder):
            os.environ["PATH"] = str(candidate.folder)
            if engine.render(base).sha256 != deck.sha256:
                problems.append("it depends on the folder or on PATH")
    finally:
        os.environ["PATH"] = before
    text = "\n".join((*deck.files.values(), *deck.command))
    places = (str(Path.cwd()), str(candidate.folder), *(word for word in candidate.build.command if "/" in word))
    problems += [f"it has {place} in it" for place in places if len(place) > 1 and place in text]
    changed = {name: engine.render(case).sha256 for name, case in candidate.changed().items()}
    seen = {deck.sha256: "nothing"}
    for name, digest in changed.items():
        if digest in seen:
            problems.append(f"{name} changes it no more than {seen[digest]} does")
        seen.setdefault(digest, name)
    words = f"the same for {len(same)} other names and gauges, another for each of {len(changed)} changes"
    yield _none(problems, words)


def deck_by_hand(candidate: Candidate) -> Iterator[Measured]:
    """The command in the deck's first line, run by a shell in a plain folder, gives the same bits."""
    engine, deck = candidate.engine, candidate.deck
    _, trace = candidate.alone
    name, text = next(iter(deck.files.items()))
    command = " ".join(deck.command)
    if command not in text.partition("\n")[0]:
        raise RunError(f"the first line of {name} is not its command, {command}")
    folder, programs = candidate.folder / "by-hand", candidate.folder / "programs"
    for place in (folder, programs):
        place.mkdir()
    deck.write(folder)
    start = programs / engine.program  # by the program's own name, whatever the build's command is
    start.write_text(f'#!/bin/sh\nexec {shlex.join(candidate.build.command)} "$@"\n')
    start.chmod(0o755)
    environment = scrubbed_environment() | engine.environment
    environment["PATH"] = f"{programs}:{environment['PATH']}"
    with open(folder / "stdout.txt", "w") as out, open(folder / "stderr.txt", "w") as err:
        ended = subprocess.run(
            command, shell=True, cwd=folder, env=environment, stdout=out, stderr=err, check=False, timeout=100
        )
    if ended.returncode:
        raise RunError(f"exit code {ended.returncode}: {(folder / 'stderr.txt').read_text()[-200:]}")
    same = digest_of(candidate.read(candidate.base, folder)) == digest_of(trace)
    yield _none([] if same else ["other bits than in a run"], f"the same bits by: {command}")
