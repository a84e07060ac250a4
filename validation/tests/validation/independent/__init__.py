"""Tests of ``validation.independent``."""
