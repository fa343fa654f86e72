"""The image model: (n+d)-dimensional Gaussians, conditioned on a latent state and rasterised.

`gaussians` conditions them (`Gaussians`), `projection` projects 3-D slices, and `backend` chooses the
rasteriser: torch (the specification), Numba on the CPU (`cpu`) or gsplat on CUDA.
"""
