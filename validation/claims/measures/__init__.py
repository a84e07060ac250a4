"""Numbers of a run with a published or theoretical value: one module each, with its measure and its theory."""
