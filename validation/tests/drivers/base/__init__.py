"""Tests of what all of the drivers stand on."""
