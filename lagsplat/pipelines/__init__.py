"""From file names to results on disk, for the command line, the workflow and the public functions.

`diagnosis` opens, diagnoses and writes (`diagnose_files`, `run_diagnosis`), `film_runs` fits a run to a film
that is the simulator, `apply_diagnosis` adds the effects that were found to a simulator, `batch` does it for
many recordings, and the other modules evaluate and view fitted runs.
"""
