"""Tests of ``validation.calibration``."""
