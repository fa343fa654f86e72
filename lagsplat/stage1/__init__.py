"""Stage 1: an encoder and a decoder of Gaussians, fitted together on appearance alone.

`autoencoder` holds both (`Autoencoder`), `fit` trains them (`fit_autoencoder`), `densification` grows and
prunes the Gaussians, and `deformation_decoder` is the decoder it is compared with.
"""
