"""The command line ``lagsplat VERB ...``: `main.main` parses it, and `verbs` does what it says."""
