"""The table of gaps from made-up diagnoses."""

import json

import pandas as pd

from lagsplat.report.diagnosis_json import diagnosis_content
from lagsplat.report.gap_table import COLUMNS, gap_rows, gap_table, latex_gap
from tests.unit.report import made_diagnoses
