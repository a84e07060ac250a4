"""Errors, messages, paths, files, processes, units, progress: used by all other folders."""
