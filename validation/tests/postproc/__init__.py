"""Tests of ``postproc``."""
