"""Readers and writers: the only code of the package that touches files."""
