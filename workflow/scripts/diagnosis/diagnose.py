"""Diagnose a fitted run against its own held-out part, or against another recording."""

from pathlib import Path

from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.pipelines.diagnosis import diagnose_files
from lagsplat.planning.job import Job

with Job(snakemake) as job:
    run = str(Path(job.input.dynamics).parent)
    real = str(job.input.real) if job.input.real else "held_out"
    out = Path(job.output.diagnosis).parent
    command = f"lagsplat diagnose sim={run} real={real} out={out}"
    diagnose_files(run, real, out, job.section(DiagnoseConfig), command=command)
