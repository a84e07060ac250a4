"""Tests of ``validation.kit``."""
