"""Verdicts: a run against the reference, a run against a run, and when they part."""
