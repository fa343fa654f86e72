"""Whitening, visibility and intrinsic dimension: how the latent chart of a frozen autoencoder is read."""
