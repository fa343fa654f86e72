"""Train an autoencoder on each nominal film, freeze it, and write what it sees in all films."""

from lagsplat.job import Job

with Job(snakemake) as job:
    raise RuntimeError("films are not encoded")
