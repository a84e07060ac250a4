"""Verdicts on runs of scenes on all engines, comparison of two runs, diagnosis of wrong runs."""
