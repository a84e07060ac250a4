"""Errors of a run, its error budget, and the time step that a wanted accuracy needs."""
