"""Batch studies: many cases of one scene, run once, kept together, and tabulated.

study (what is varied) -> planned (cases with their identities) -> worker (runs them, served by sessions)
-> store (finished rows) -> table. ``on_clusters`` only says where else workers run.
"""
