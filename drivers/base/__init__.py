"""Errors, messages, paths, files, processes, units: what every room above stands on."""
