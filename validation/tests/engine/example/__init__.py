"""Example of an engine of one's own: a code in C, its adapter, its entry."""
