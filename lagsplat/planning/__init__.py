"""What Snakemake asks: which runs and files an experiment needs, and what of them is out of date.

Public: `plan.planned_runs`, `plan.compose_for`, `lineage.lineage`, and `job.Job`, the frame of every script.
"""
