"""The script ``templates/serve.sh`` serves any code that runs a deck by one command."""

import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import psutil

from drivers.base.decks import Deck, render
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import digest_of
from drivers.engines import load_engine
from drivers.run.compute import Session
from drivers.run.scheme import checked_trace
from validation.tests.helpers.scenes import case_of


def test_the_script_serves_deck_after_deck_and_ends_at_a_broken_one(tmp_path: Path) -> None:
    case, verlet = case_of("fig4", "run.duration=20 us"), load_engine("verlet")
    deck = verlet.render(case)
    server = Deck({"serve.sh": render("serve.sh")}, ("sh", "serve.sh", *deck.command), raw=())
    broken = replace(deck, files=dict.fromkeys(deck.files, "{"))
    with closing(Session(replace(verlet, server=server), (sys.executable,), tmp_path)) as session:
        for served, code in ((deck, 0), (deck, 0), (broken, 1), (deck, 0)):
            outcome = session.run(served, 60.0)
            assert (outcome.code, session.ended) == (code, code == 1)
            if not code:
                trace = checked_trace(case, verlet, outcome, session.case)
                assert digest_of(trace) == digest_of(verlet_of(case))
        assert session._launched is not None
        for process in psutil.Process(session._launched[0].pid).children(recursive=True):
            process.kill()  # while it is idle
        psutil.wait_procs([psutil.Process(session._launched[0].pid)], 5.0)
        assert session.run(deck, 60.0).code == -9
