"""Tests of ``drivers.batch``."""
