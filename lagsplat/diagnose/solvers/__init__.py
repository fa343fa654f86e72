"""The room `solvers`."""
