#!/usr/bin/env bash
# Runs once in the new environment, in the folder where Snakemake runs: a checkout, whose versions are exact, or
# one that `lagsplat init` or snakedeploy made.
set -euo pipefail
if [ -f requirements/lock.txt ] && [ -f pyproject.toml ]; then
    python -m pip install --requirement requirements/lock.txt
    python -m pip install --no-deps --editable .
else
    python -m pip install lagsplat
fi
