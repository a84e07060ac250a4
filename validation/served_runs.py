"""Cases run one after another by one process of a code, without run folders."""

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

from drivers.base.errors import RunError
from drivers.base.progress import say
from drivers.chain.case import Case
from drivers.chain.trace import Trace
from drivers.engines import load_engine
from drivers.run.guard import checked_trace
from drivers.run.run import default_limit_s
from drivers.run.session import Session, lent


@dataclass(frozen=True)
class Served:
    """Trace of a case, with the times of its time loop and of the whole case in s."""

    trace: Trace
    loop_s: float
    case_s: float


@contextmanager
def left_out_if_failed(what: str) -> Iterator[None]:
    """Reports a failed run and continues the study without its row."""
    try:
        yield
    except RunError as error:
        say(f"{what} is left out: {error}")


def serving(name: str) -> AbstractContextManager[Session]:
    """Session of an installed engine."""
    engine = load_engine(name)
    command = engine.find()
    assert command is not None
    return lent(engine, command)


def serve(session: Session, case: Case) -> Served:
    """Runs a case in a session; RunError if it failed."""
    outcome = session.run(session.engine.render(case), default_limit_s(case, session.engine))
    trace = checked_trace(case, session.engine, outcome, session.case)
    loop_s = session.engine.loop_seconds((session.case / "stdout.txt").read_text(errors="replace"))
    return Served(trace, loop_s or 0.0, outcome.wall_s)
