"""The command ``beads``: one module of commands for each theme, options that are defined once, errors in one line."""
