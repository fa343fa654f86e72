"""The latent coordinates of a trained autoencoder: whitening, visibility metric, dimension, time base.

`chart` fits and stores them (`Chart`, `fit_chart`), `visibility` measures how much each coordinate changes
the image, and `trajectory` smooths the encoded states.
"""
