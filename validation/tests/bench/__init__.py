"""Benchmarks: costs as ratios taken in one run."""
