"""Effects of camera and clock, which leave the mechanism as it is; one a file."""
