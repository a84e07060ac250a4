"""Tests of ``drivers.engines``."""
