"""A table of the chapter on published numbers, as if every number had been hit."""

from validation.checks import PASS, Check
from validation.claims.cases import read_independent
from validation.claims.claim import PLAIN_READING, read_claims
from validation.claims.judged import check_of

CASE_ENGINES = ("liggghts", "reference", "yade")


def published_checks(engines: tuple[str, ...] = CASE_ENGINES) -> list[Check]:
    """Checks of all claims by the reference, with the published values, and of all cases by some engines."""
    claims = [
        check_of(claim, reading, "reference", claim.quoted)
        for claim in read_claims().claim
        for reading in claim.readings or (PLAIN_READING,)
    ]
    cases = [
        Check(entry.id, engine, f"{check.quantity} against {check.against}", 1e-13, check.limit, check.reason,
              "found 1, expected 1: somebody", PASS, 1.0 + 1e-13, 1.0)
        for entry in read_independent() for engine in engines for check in entry.check
    ]  # fmt: skip
    return [*claims, *cases]
