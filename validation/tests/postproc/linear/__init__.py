"""Tests of linear theory and spectra."""
