"""Tests of ``postproc.draw``."""
