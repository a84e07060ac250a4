"""Tests of an engine in a minute: those that tell most come first, and those that passed before are left out."""

import time

import pytest

from drivers.base import paths
from drivers.base.cache import content_of, load, store
from drivers.base.terminal import in_words
from drivers.engines import load_engine
from drivers.run.build import build_of
from validation.tests.engine.candidate import case_with

# tests in their order, with the number of decks that each runs
DECKS = {
    "test_interface": 0,
    "test_version": 0,
    "test_deck": 0,
    "test_start": 1,
    "test_scene": 1,
    "test_changed_decks": 14,
    "test_order": 3,
    "test_restitution": 1,
    "test_blow_up": 2,
    "test_deck_by_hand": 2,
    "test_failures_and_time_limit": 2,
    "test_damaged_output": 4,
    "test_server": 14,
}
TOLD_AFTER = 5  # decks, which give the time of the others
STARTS = 8  # of processes
MINUTE_S = 60.0


class Kit:
    """Plugin of pytest that runs the tests of an engine until they have ended or its time is over.

    Attributes:
        before, passed: names of the tests that the build passed, or skipped for a reason, before and now.
        failed: names of those that failed now.
        decks: number of decks of each test that was not run yet.
    """

    def __init__(self, name: str, within_s: float, *, again: bool = False) -> None:
        """Kit of an engine, for some time; with ``again`` tests that passed before are run again."""
        engine = load_engine(name)
        tests = [*paths.ROOT.glob("validation/tests/engine/*.py")]
        self.key = ["tests", name, build_of(engine).identity, engine.render(case_with()).sha256, content_of(tests)]
        self.before: set[str] = {*(load(self.key) or ())}
        self.passed: set[str] = set()
        self.failed: set[str] = set()
        self.again, self.over = again, ""
        self.last_s = time.perf_counter()  # end of the last test
        self.until_s = self.last_s + within_s
        self.decks: list[int] = []
        self.run, self.start_s = 0, 0.0  # decks; time of the first one, with the start of the server

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(
        self, session: pytest.Session, config: pytest.Config, items: list[pytest.Item]
    ) -> None:
        """Sort the tests, and leave out those that passed before."""
        known = [] if self.again else [item for item in items if item.name in self.before]
        config.hook.pytest_deselected(items=known)
        items[:] = [item for item in items if item not in known]
        items.sort(key=lambda item: [*DECKS].index(_kind(item.name)))
        self.decks = [DECKS[_kind(item.name)] for item in items]
        self.session = session

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the outcome of a test."""
        name = report.nodeid.rpartition("::")[2]
        if report.failed:
            self.failed.add(name)
        elif report.when == "teardown" and name not in self.failed:
            self.passed.add(name)
        store(self.key, sorted(self.before - self.failed | self.passed))

    def pytest_runtest_logfinish(self) -> None:
        """Tell the time that the rest will take, and end before a test for which there is no time."""
        now_s, decks = time.perf_counter(), self.decks.pop(0)
        deck_s = (now_s - self.last_s) / max(decks, 1)
        self.run, before, self.last_s = self.run + decks, self.run, now_s
        self.start_s = self.start_s or deck_s * bool(decks)
        if before < TOLD_AFTER <= self.run:
            rest_s = deck_s * sum(self.decks) + STARTS * self.start_s
            print(f" {self.left} more tests take about {in_words(rest_s)} ", end="", flush=True)
        if self.decks and now_s + deck_s * self.decks[0] > self.until_s:
            self.session.shouldstop = self.over = "the time is over"

    @property
    def left(self) -> int:
        """Number of tests that were not run."""
        return len(self.decks)


def _kind(name: str) -> str:
    return name.partition("[")[0]
