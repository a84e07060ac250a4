"""The paper's figures and its table, one module each.

A module's ``make(runs)`` runs what it needs, unless it is done, and returns a ``Product``. These modules compose:
they stand on top of everything else.
"""
