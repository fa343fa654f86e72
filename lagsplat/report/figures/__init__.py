"""Figures of a fitted run: reconstruction, latents, rollouts, forces, inertia and comparisons of models."""
