"""Effects between the command and the mechanism, and forces from outside; one a file."""
