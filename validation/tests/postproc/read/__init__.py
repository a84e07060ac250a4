"""Tests of ``postproc.read``."""
