"""Tests of ``drivers/inventory``."""
