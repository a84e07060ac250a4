"""Verdicts: a run against the reference, a run against a run, when they part, and what a run that is off matches."""
