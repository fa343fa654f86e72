"""The table of gaps from made-up diagnoses."""
