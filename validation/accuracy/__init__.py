"""Errors of a run, its error budget, and the time step that keeps a wanted accuracy."""
