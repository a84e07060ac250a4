"""Tests of ``validation.claims``."""
