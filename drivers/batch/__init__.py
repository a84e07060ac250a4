"""Batch studies: many cases of one scene, run once and tabulated.

study (varied values) -> study_cases (cases with identities) -> worker (runs cases on server processes) -> store
(finished rows) -> study_table. ``on_clusters`` runs slices of a study on Dask or Slurm.
"""
