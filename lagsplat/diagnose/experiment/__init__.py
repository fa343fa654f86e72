"""The next experiment: what to record so that the two leading hypotheses of a diagnosis separate."""
