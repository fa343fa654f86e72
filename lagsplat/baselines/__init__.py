"""Four published video models of the pneumatic arm: one encoder, two decoders, two linear laws of motion."""
