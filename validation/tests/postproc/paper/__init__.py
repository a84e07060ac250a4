"""Tests of ``postproc.paper``."""
