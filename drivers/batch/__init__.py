"""Batch studies: many cases of one scene, run once, kept together, and tabulated.

study (what is varied) -> planned (cases with their identities) -> worker (runs them, served by sessions)
-> store (finished rows) -> table. ``local``, ``on_dask`` and ``on_slurm`` only say where workers run.
"""
