"""Accuracy of the answer to a force, against simulated truth and against what must hold without it.

`known_forces` simulates the true answer (`simulate_known_forces`), `accuracy` compares the model's with it,
`motion` follows it in time, and `invariants` measures what needs no truth (`measure_forces`,
`force_invariants`).
"""
