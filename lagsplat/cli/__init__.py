"""The command line ``lagsplat VERB ...``: `main.main` parses it, `run` and `diagnose` hold the verbs."""
