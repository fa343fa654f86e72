"""What all of a diagnosis shares: its settings, its thresholds, and its result as plain data.

`config` holds what a user sets (`DiagnoseConfig`) and every number that can change a verdict, with unit and
source; `result` holds `Diagnosis`, `Candidate`, `Gap` and `Finding`.
"""
