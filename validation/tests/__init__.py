"""Tests; real engines run if they are installed, and always in CI."""
