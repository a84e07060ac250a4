"""Deck -> run folder: run a case once, check its output, record it, find it again."""
