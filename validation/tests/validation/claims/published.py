"""Checks of published numbers, as if every number had been hit."""

from drivers.base import paths
from validation.chapters.claims import check_of, read_claims
from validation.checks import PASS, Check

CASE_ENGINES = ("liggghts", "reference", "yade")


def published_checks(engines: tuple[str, ...] = CASE_ENGINES) -> list[Check]:
    """Checks of all statements by the reference, with the published values, and of all cases by some engines."""
    statements = [
        check_of(claim, reading.words, "reference", claim.expected, claim.expected)
        for claim in read_claims()
        for reading in claim.readings
        if claim.expected is not None
    ]
    cases = [
        Check(claim.id, engine, f"{claim.quantity} against {claim.against}", 1e-13, claim.limit, claim.reason,
              "found 1, expected 1: somebody", PASS, 1.0 + 1e-13, 1.0)
        for claim in read_claims(paths.INDEPENDENT) for engine in engines
    ]  # fmt: skip
    return [*statements, *cases]
