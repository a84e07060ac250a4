"""Tests of ``validation.compare``."""
