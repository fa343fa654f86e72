"""Forces given in the image: what they grip, what they are to the latent law, and what it answers."""
