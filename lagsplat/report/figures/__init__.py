"""Figures of a fitted run: reconstruction, latents, rollouts, forces, inertia and comparisons of models.

Each ``draw_...`` function returns a Matplotlib figure; `lagsplat.report.common.style.save_figure` writes it.
"""
