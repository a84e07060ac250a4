"""Batch studies: many cases of one scene, run once and tabulated.

study (varied values) -> rows (cases that are planned and run) -> store (the database) -> tables. ``job_array`` runs
slices of a study on Slurm.
"""
