"""Existing runs: listed, found by name and settings, and removed if no command would use them."""
