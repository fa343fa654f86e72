"""The latent coordinates of a trained autoencoder: whitening, visibility metric, dimension, time base."""
