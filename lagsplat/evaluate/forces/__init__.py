"""How true the answer to a force is, where the simulated system knows it.

`known_forces` simulates the true answer (`simulate_known_forces`), `accuracy` compares ours with it,
`motion` and `invariants` measure what must hold without a truth (`measure_forces`, `force_invariants`).
"""
