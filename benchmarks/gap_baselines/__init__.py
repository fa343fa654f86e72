"""What else one might take to name an unmodelled effect, for the table of the blind check."""
