"""Tests of ``drivers.run``."""
