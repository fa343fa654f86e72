"""The latent coordinates of a trained autoencoder: whitening, visibility metric, intrinsic dimension, time
base.

`chart` fits and keeps them (`Chart`, `fit_chart`), `visibility` measures how much each coordinate changes
the image, and `trajectory` smooths the encoded states.
"""
