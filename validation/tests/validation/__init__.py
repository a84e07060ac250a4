"""Tests of ``validation``."""
