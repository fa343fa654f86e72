"""Forces from outside, and properties that change with time; one a file."""
