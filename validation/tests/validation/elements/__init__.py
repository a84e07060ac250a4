"""Tests of ``validation.elements``."""
