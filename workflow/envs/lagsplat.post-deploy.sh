#!/usr/bin/env bash
# Runs once in the new environment, from the root of the checkout: installs the package and what it pins.
set -euo pipefail
python -m pip install --editable .
