"""Latent Lagrangian mechanics: mass, damping, potential and actuation learned in whitened latents."""
