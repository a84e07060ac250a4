"""Tests of ``postproc.figures``."""
