"""Springs, contact and what remembers how it was deformed; one a file."""
