"""Tests of any engine: an adapter with a build of its code. ``pytest --engine NAME`` runs them on an entry."""
