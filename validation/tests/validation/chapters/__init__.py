"""Tests of ``validation.chapters``."""
