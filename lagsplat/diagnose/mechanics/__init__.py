"""The mechanical model of a simulator: mass, damping, potential and input map in one basis of functions."""
