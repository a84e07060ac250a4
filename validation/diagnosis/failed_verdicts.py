"""Diagnoses of those runs of a scene that failed a verdict."""

from collections.abc import Iterable, Mapping

from drivers.chain.case import Case
from drivers.chain.trace import Trace
from validation.compare.verdict import FAIL, Verdict
from validation.diagnosis.diagnose import diagnose

ITS_OWN = (
    "the run is its scene at its time step, but for rounding: what it misses is the time step's, or that of what it is "
    "measured against"
)


def diagnoses_of(case: Case, verdicts: Iterable[Verdict], traces: Mapping[str, Trace]) -> dict[str, str]:
    """What each engine with a failed verdict matches, in a sentence.

    Args:
        case: the case that was run.
        verdicts: on all its runs.
        traces: by engine, also of runs that a guard failed; an engine without one gets no diagnosis.
    """
    red = dict.fromkeys(verdict.engine for verdict in verdicts if verdict.verdict == FAIL)
    found = {engine: diagnose(case, engine, traces[engine]) for engine in red if engine in traces}
    return {engine: diagnosis.sentence if diagnosis else ITS_OWN for engine, diagnosis in found.items()}
