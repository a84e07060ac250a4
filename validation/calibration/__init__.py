"""Calibration: parameters of scenes fitted to measured data, with their uncertainty."""
