"""Tests of ``validation.accuracy``."""
