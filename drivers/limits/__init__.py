"""Limits of the time step, refusal of cases that would fail, and the exactness that an error needs."""
