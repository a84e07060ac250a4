"""Tests of ``validation.report``."""
