"""The image model: (n+d)-dimensional Gaussians, conditioned on a latent state, projected and rasterised."""
