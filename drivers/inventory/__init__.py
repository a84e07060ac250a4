"""Runs that a folder keeps: listed, found by name and settings, and those of no use removed."""
