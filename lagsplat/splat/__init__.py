"""The image model: Gaussians sliced at a latent, and the rasterisers that draw them."""
