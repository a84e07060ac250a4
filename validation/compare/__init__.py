"""Verdicts on runs, comparison of two runs, first departure from the exact motion, diagnosis of faulty runs."""
