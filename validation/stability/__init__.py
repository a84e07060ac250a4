"""Limits of the time step and their prediction, extreme scenes, long runs, and rounding."""
