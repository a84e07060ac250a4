"""Tests of ``validation.reference``."""
