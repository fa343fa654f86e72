"""Stage 1: an encoder and a decoder of Gaussians, fitted together to the frames alone.

`autoencoder` holds both (`Autoencoder`), `fit` trains them (`fit_autoencoder`), `densification` splits and
teleports Gaussians, and `planar_decoder` is the decoder they are compared with.
"""
