"""Batch studies: many cases of one scene, run once and tabulated.

study (varied values) -> study_cases (all cases validated, with identities; missing rows) -> study_rows (cases that are
run) -> store (finished rows) -> study_table. ``job_array`` runs slices of a study on Slurm.
"""
