"""Effects between the command and the mechanism; one a file."""
