"""Tests of ``drivers.chain``."""
