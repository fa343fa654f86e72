"""The CPU rasteriser, compiled by Numba: eight pixels at a time, in parallel over frames.

`rasterize` is differentiable, `slice` draws one frame for the viewer (`FrameRasterizer`); `tiles`, `forward`
and `backward` are the kernels, `simd` their eight-wide floats.
"""
