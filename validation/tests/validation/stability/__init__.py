"""Tests of ``validation.stability``."""
