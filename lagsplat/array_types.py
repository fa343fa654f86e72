"""Conventions of the whole package, and the names of its array shapes.

Images. Stored frames are ``uint8`` of shape ``(T, H, W, 3)``, RGB. Inside torch an image batch is
``float32`` of shape ``(B, 3, H, W)`` with colours in [0, 1]. The pixel in row ``i`` and column ``j`` has its
centre at ``x = j + 0.5``, ``y = i + 0.5``; ``x`` points right, ``y`` down, and the origin is the upper left
corner of the image. The spatial unit of a Gaussian is the pixel of the training resolution.

Latents. ``z`` is raw: what the encoder returns. ``q`` is whitened, with the row convention
``q = (z - mean) @ whiten`` and ``z = mean + q @ unwhiten``. Everything after the chart is written in ``q``
and computed in ``float64``.

Time. Every public signature takes seconds (``dt_s``), and velocities are whitened units per second. Frames
need not be evenly spaced: ``dt_s`` is then their median spacing, and steps and velocities are of their true
times. Inside the Lagrangian one time unit is ``time_unit_s`` seconds; it is stored with the dynamics.

Inputs. ``u`` has shape ``(T, n_u)``; ``n_u = 0`` means an autonomous system. Chamber pressures are in atm.
Input ``i`` is held over the step from frame ``i`` to frame ``i + 1``, unless the law interpolates inputs.

Axis names: ``T`` frames of a recording, ``N`` states of a rollout, ``B`` batch, ``K`` Gaussians, ``d`` latent
dimension, ``n_u`` inputs, ``H`` rows, ``W`` columns.
"""

import numpy as np
from jaxtyping import Float, Float32, Float64, UInt8
from torch import Tensor

Frames = UInt8[np.ndarray, "T H W 3"]
Images = Float32[Tensor, "B 3 H W"]
Latent = Float[Tensor, " d"]
Latents = Float[Tensor, "B d"]
Inputs = Float[Tensor, "B n_u"]
Spd = Float[Tensor, "B d d"]
Metric = Float[Tensor, "d d"]
Scalar = Float[Tensor, ""]
Series = Float64[np.ndarray, "T m"]
Vector = Float64[np.ndarray, " d"]
