"""Tests; the real engines run wherever they are installed, and always in CI."""
