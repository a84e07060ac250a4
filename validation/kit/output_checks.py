"""Checks of the output of an engine and of its end: damaged output, failures, time limit, server."""

import shutil
import time
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from pathlib import Path

from drivers.base.decks import Deck
from drivers.base.errors import RunError
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.trace import digest_of
from drivers.limits.refusal import inability
from drivers.run.guard import START_TOLERANCE, checked_trace
from drivers.run.session import DONE, MAX_START_S, Session
from validation.accuracy.costs import entry_of, measure
from validation.compare.departure import deviation
from validation.kit.candidate import Candidate, Measured, case_with, within
from validation.served_runs import serve

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


def start(candidate: Candidate) -> Iterator[Measured]:
    """The trace begins with the state of the scene at time 0, not a step or half a step off."""
    moving = "chain.bead=[{from_wall=3, gap_below='20 um', velocity='0.1 m/s'}, {from_wall=1, velocity='-0.2 m/s'}]"
    case = case_with("chain.precompression=2 N", "chain.origin=0.1 m", moving)
    trace, chain = candidate.run(case), case.chain
    if trace.height_m is None or trace.velocity_m_s is None:
        raise RunError("the trace has no heights and velocities")
    for name, found, right in (
        ("force", trace.force_N, chain.force_N),
        ("velocity", trace.velocity_m_s, chain.velocity_m_s),
    ):
        share = float(abs(found[0] - right).max() / abs(found).max())
        yield Measured(share, START_TOLERANCE, f"error of the {name} at time 0, relative to the largest")
    moved = abs(trace.height_m - chain.height_m)
    yield within(
        "height", float(moved[0].max() / moved.max()), "error of the heights at time 0, relative to the motion"
    )


def damaged_output(candidate: Candidate) -> Iterator[Measured]:
    """Missing or torn output and output of another case raise RunError or change nothing.

    Flipped bytes raise no other error, but may change forces, as some formats cannot detect them.
    """
    folder, trace = candidate.alone
    place, problems, counts = candidate.folder / "damaged", list[str](), Counter[str]()
    for words, contents, may_differ in _damages(candidate, _output(candidate.deck, folder)):
        shutil.copytree(folder, place)
        for name, content in contents.items():
            if content is None:
                (place / name).unlink()
            else:
                (place / name).parent.mkdir(exist_ok=True)
                (place / name).write_bytes(content)
        try:
            same = digest_of(candidate.read(candidate.base, place)) == digest_of(trace)
        except RunError:
            counts["a RunError"] += 1
        except Exception as error:  # adapters may raise anything
            problems.append(f"{words}: {type(error).__name__}: {error}")
        else:
            counts["no difference" if same else "another trace"] += 1
            if not (same and any(contents.values())) and not may_differ:
                problems.append(f"{words}: read without an error")
        shutil.rmtree(place)
    results = ", ".join(f"{count} gave {words}" for words, count in counts.items())
    yield Measured(len(problems), 0, "; ".join(problems[:3]) or f"of {counts.total()} damages {results}")


def _damages(candidate: Candidate, output: Output) -> Iterator[tuple[str, Mapping[str, bytes | None], bool]]:
    """Damages: description, contents of files by name (None for a missing file), and True if forces may differ."""
    yield "no raw output", dict.fromkeys(output), False
    for name, whole in output.items():
        for share in TORN_SHARES:
            yield f"{name} torn at {share:g}", {name: whole[: int(share * len(whole))]}, False
        for words, content in REPLACEMENTS.items():
            yield f"{words} in place of {name}", {name: content}, False
        spread = (number * (len(whole) - 1) // FLIPS for number in range(FLIPS))
        for at in {*range(min(FLIPS, len(whole))), *spread}:
            flipped = whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :]
            yield f"byte {at} of {name} flipped", {name: flipped}, True
    for words, settings in OTHER_CASES.items():
        other = case_with(*settings)
        deck = candidate.engine.render(other)
        folder, outcome = candidate.execute(other, deck)
        if outcome.code:
            raise RunError(f"{words}: exit code {outcome.code}")
        printed = {"stdout.txt": (folder / "stdout.txt").read_bytes()}
        yield f"output of {words}", {**dict.fromkeys(output), **_output(deck, folder), **printed}, False


def _output(deck: Deck, folder: Path) -> Output:
    """Raw output files by name, including files in output folders."""
    found = (
        path
        for name in deck.raw
        for path in ((folder / name).rglob("*") if (folder / name).is_dir() else [folder / name])
    )
    return {str(path.relative_to(folder)): path.read_bytes() for path in found if path.is_file()}


def failures(candidate: Candidate) -> Iterator[Measured]:
    """A bad deck fails with the engine's own message; at the time limit all processes of a run end."""
    folder, outcome = candidate.process(_broken(candidate.deck), "broken", 60.0)
    words = ""
    try:
        checked_trace(candidate.base, candidate.engine, outcome, folder)
    except RunError as error:
        words = str(error)
    if not words or words.endswith("no output"):
        raise RunError(f"a bad deck: {words or 'done'}")
    case = case_with(*ENDLESS)
    began = time.perf_counter()
    folder, outcome = candidate.process(candidate.engine.render(case), "endless", LIMIT_S)
    if not outcome.timed_out:
        raise RunError(f"a run of {case.scene.steps:.0e} steps ended before its time limit, exit code {outcome.code}")
    until = began + LIMIT_S + tolerance("kit", "late").limit
    while (left := _processes_in(folder)) and time.perf_counter() < until:
        time.sleep(0.05)
    if left:
        raise RunError(f"{left} processes continued after the time limit")
    late_s = time.perf_counter() - began - LIMIT_S
    yield within("late", late_s, f"seconds from the time limit to the end of all processes; a bad deck gives: {words}")


def _broken(deck: Deck) -> Deck:
    return Deck(dict.fromkeys(deck.files, BAD_DECK), deck.command, deck.raw)


def _processes_in(folder: Path) -> int:
    """Number of processes that run in a folder, on systems with /proc."""
    found = 0
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            found += (process / "cwd").readlink() == folder
    return found


def server(candidate: Candidate) -> Iterator[Measured]:
    """The server gives the same bits as a single process, in any order, after a bad deck and after a timeout."""
    engine, base = candidate.engine, candidate.base
    _, alone = candidate.alone
    right, served = {id(base): alone}, 0
    others = [case for settings in CASES_BETWEEN if not inability(case := case_with(*settings), engine.name)]
    with closing(Session(engine, candidate.build.command, candidate.folder / "server")) as session:

        def ask(case: Case, when: str) -> None:
            """Compare a case with its single run, or with its first run here; RunError if it differs."""
            nonlocal served
            try:
                trace = serve(session, case).trace
            except RunError as error:
                silent = f"; the server printed no line {DONE} before" if error.status == "timeout" else ""
                raise RunError(f"{when}: {error}{silent}") from error
            served += 1
            before = right.setdefault(id(case), trace)
            if digest_of(trace) != digest_of(before):
                raise RunError(f"{when}: forces differ by {deviation(trace, before).share:.1e}")

        began = time.perf_counter()
        ask(base, "first case")
        ask(base, "again")
        for other in others:
            ask(other, "another case")
            ask(base, "after another case")
            ask(other, "another case again")
        case_s = (time.perf_counter() - began - session.start_s) / served
        for words, deck, limit_s in (
            ("a bad deck", _broken(candidate.deck), 60.0),
            ("a run beyond its time limit", engine.render(case_with(*ENDLESS)), LIMIT_S),
        ):
            outcome, done = session.run(deck, limit_s), True
            try:
                checked_trace(base, engine, outcome, session.case)
            except RunError:
                done = False
            if done:
                raise RunError(f"{words} is done")
            ask(base, f"after {words}")
    words = f"identical to single runs after other cases, a bad deck and a timeout; {case_s:.3f} s per case"
    yield Measured(0, 0, words)


def cost(candidate: Candidate) -> Iterator[Measured]:
    """The cost of runs can be measured, and the output contains the time in the loop."""
    found = measure(candidate.engine, candidate.build)
    folder, _ = candidate.alone
    loop_s = candidate.engine.loop_seconds((folder / "stdout.txt").read_text(errors="replace"))
    if loop_s is None:
        raise RunError("no line of the output matches loop_pattern")
    words = "\n".join(["seconds to start a process", *entry_of(candidate.engine.name, found)])
    yield Measured(found.start_s, MAX_START_S, words)
