"""Stage 1: the encoder and the Gaussian decoder, fitted together on appearance alone."""
