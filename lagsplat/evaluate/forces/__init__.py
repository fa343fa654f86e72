"""Accuracy of the answer to a force, against the truth of a simulated system and against what must hold
anyway.

`known_forces` simulates the true answer (`simulate_known_forces`), `accuracy` compares the model's with it,
`motion` follows it in time, and `invariants` measures what needs no truth (`measure_forces`,
`force_invariants`).
"""
