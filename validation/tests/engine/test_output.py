"""The output of an engine and its end: damaged output, failures, time limit, server."""

import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from pathlib import Path

import pytest

from drivers.base.decks import Deck
from drivers.base.errors import RunError
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.schemes import default_limit_s
from drivers.chain.trace import digest_of
from drivers.limits import inability
from drivers.run.compute import DONE, Session
from drivers.run.scheme import checked_trace
from validation.tests.engine.candidate import Candidate, case_with

FLIPS = 16  # bytes flipped one at a time, at the head of each file and throughout
TORN_SHARES = (0.0, 0.3, 0.999)  # parts of a file left when it is torn
REPLACEMENTS = {"text": b"no output of anything\n", "JSON": b"{}\n", "zip": b"PK\x03\x04 torn", "zeros": bytes(4096)}
OTHER_CASES = {
    "another number of beads": ("chain.count=4",),
    "another number of samples": ("run.duration=0.2 ms",),
    "another striker speed": ("striker.speed=1.1 m/s",),
    "another gravity": ("gravity=",),
}
ENDLESS = ("run.duration=200 s", "run.sample_interval=2 ms", "run.time_step=0.1 us")  # 2e9 steps
# cases on a server between runs of the kit's scene, which must not depend on them
CASES_BETWEEN = (
    ("chain.count=3", "wall="),
    ("contact.restitution=0.5", "gravity="),
    ("chain.precompression=2 N", "striker.speed=2 m/s"),
)
LIMIT_S = 1.0
Output = Mapping[str, bytes]  # files by name
BAD_DECK = "this is no deck (\n"


def test_start(candidate: Candidate) -> None:
    """The trace begins with the state of the scene at time 0, not a step or half a step off."""
    moving = "chain.bead=[{from_wall=3, gap_below='20 um', velocity='0.1 m/s'}, {from_wall=1, velocity='-0.2 m/s'}]"
    case = case_with("chain.precompression=2 N", "chain.origin=0.1 m", moving)
    trace, chain = candidate.run(case), case.chain
    assert trace.height_m is not None
    assert trace.velocity_m_s is not None
    for values, right in ((trace.force_N, chain.force_N), (trace.velocity_m_s, chain.velocity_m_s)):
        assert abs(values[0] - right).max() <= tolerance("model", "motion").limit * abs(values).max()
    moved = abs(trace.height_m - chain.height_m)
    assert moved[0].max() <= tolerance("kit", "height").limit * moved.max()


def test_damaged_output(candidate: Candidate) -> None:
    """Missing or torn output and output of another case raise RunError or change nothing.

    Flipped bytes raise no other error, but may change forces, as some formats cannot detect them.
    """
    folder, trace = candidate.alone
    place, problems = candidate.folder / "damaged", list[str]()
    for damage, contents, may_differ in _damages(candidate, _output(candidate.deck, folder)):
        shutil.copytree(folder, place)
        for name, content in contents.items():
            (place / name).unlink(missing_ok=True)
            if content is not None:
                (place / name).parent.mkdir(exist_ok=True)
                (place / name).write_bytes(content)
        try:
            same = digest_of(candidate.read(candidate.base, place)) == digest_of(trace)
        except RunError:
            pass
        except Exception as error:  # adapters may raise anything
            problems.append(f"{damage}: {type(error).__name__}: {error}")
        else:
            if not (same and any(contents.values())) and not may_differ:
                problems.append(f"{damage}: read without an error")
        shutil.rmtree(place)
    assert not problems, "\n".join(problems)


def _damages(candidate: Candidate, output: Output) -> Iterator[tuple[str, Mapping[str, bytes | None], bool]]:
    """Damages: description, contents of files by name (None for a missing file), and True if forces may differ."""
    yield "no raw output", dict.fromkeys(output), False
    for name, whole in output.items():
        for share in TORN_SHARES:
            yield f"{name} torn at {share:g}", {name: whole[: int(share * len(whole))]}, False
        for kind, content in REPLACEMENTS.items():
            yield f"{kind} in place of {name}", {name: content}, False
        spread = (number * (len(whole) - 1) // FLIPS for number in range(FLIPS))
        for at in {*range(min(FLIPS, len(whole))), *spread}:
            flipped = whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :]
            yield f"byte {at} of {name} flipped", {name: flipped}, True
    for other, settings in OTHER_CASES.items():
        case = case_with(*settings)
        deck = candidate.engine.render(case)
        folder, outcome = candidate.execute(case, deck)
        if outcome.code:
            raise RunError(f"{other}: exit code {outcome.code}")
        printed = {"stdout.txt": (folder / "stdout.txt").read_bytes()}
        yield f"output of {other}", {**dict.fromkeys(output), **_output(deck, folder), **printed}, False


def _output(deck: Deck, folder: Path) -> Output:
    """Raw output files by name, including files in output folders."""
    paths = [path for name in deck.raw for path in (folder / name, *(folder / name).rglob("*")) if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


def test_failures_and_time_limit(candidate: Candidate) -> None:
    """A bad deck fails with the engine's own message; at the time limit all processes of a run end."""
    folder, outcome = candidate.process(_broken(candidate.deck), "broken", 60.0)
    with pytest.raises(RunError) as error:
        checked_trace(candidate.base, candidate.engine, outcome, folder)
    assert not str(error.value).endswith("no output")
    case = case_with(*ENDLESS)
    began = time.perf_counter()
    folder, outcome = candidate.process(candidate.engine.render(case), "endless", LIMIT_S)
    assert outcome.timed_out, f"a run of {case.scene.steps:.0e} steps ended before its time limit"
    until = began + LIMIT_S + tolerance("kit", "late").limit
    while (left := _processes_in(folder)) and time.perf_counter() < until:
        time.sleep(0.05)
    assert not left, f"{left} processes continued after the time limit"


def _broken(deck: Deck) -> Deck:
    return Deck(dict.fromkeys(deck.files, BAD_DECK), deck.command, deck.raw)


def _processes_in(folder: Path) -> int:
    """Number of processes that run in a folder, on systems with /proc."""
    inside = 0
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            inside += (process / "cwd").readlink() == folder
    return inside


def test_server(candidate: Candidate) -> None:
    """The server gives the same bits as a single process, in any order, after a bad deck and after a timeout."""
    engine, base = candidate.engine, candidate.base
    folder, alone = candidate.alone
    printed = (folder / "stdout.txt").read_text(errors="replace")
    assert engine.loop_seconds(printed) is not None, "no line of the output matches loop_pattern"
    right = {id(base): alone}
    others = [case for settings in CASES_BETWEEN if not inability(case := case_with(*settings), engine.name)]
    with closing(Session(engine, candidate.build.command, candidate.folder / "server")) as session:

        def ask(case: Case, when: str) -> None:
            """Compare a case with its single run, or with its first run here."""
            try:
                outcome = session.run(engine.render(case), default_limit_s(case))
                trace = checked_trace(case, engine, outcome, session.case)
            except RunError as error:
                silent = f"; the server printed no line {DONE} before" if error.status == "timeout" else ""
                raise RunError(f"{when}: {error}{silent}") from error
            before = right.setdefault(id(case), trace)
            assert digest_of(trace) == digest_of(before), f"{when}: other forces"

        def fail(deck: Deck, limit_s: float) -> None:
            """Run a deck that has to fail."""
            outcome = session.run(deck, limit_s)
            with pytest.raises(RunError):
                checked_trace(base, engine, outcome, session.case)

        ask(base, "first case")
        ask(base, "again")
        for other in others:
            ask(other, "another case")
            ask(base, "after another case")
            ask(other, "another case again")
        fail(_broken(candidate.deck), 60.0)
        ask(base, "after a bad deck")
        fail(engine.render(case_with(*ENDLESS)), LIMIT_S)
        ask(base, "after a run beyond its time limit")
