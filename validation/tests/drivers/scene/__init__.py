"""Tests of ``drivers.scene``."""
