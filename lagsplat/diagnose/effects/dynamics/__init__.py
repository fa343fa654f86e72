"""Effects of the mechanism itself: its parameters, friction, memory, contact, missing parts; one a file."""
