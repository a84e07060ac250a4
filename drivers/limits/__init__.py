"""Limits of the time step, and refusal of cases that would fail."""
