"""Pictures of a session, at a size of one's own choice."""

import numpy as np
from jaxtyping import Float64, UInt8

from lagsplat.chart.chart import Chart
from lagsplat.splat.one_picture import OnePicture
from lagsplat.stage1.autoencoder import Autoencoder


class Easel:
    """Draws whitened states; ``stretch`` pixels of the picture make one of the training resolution."""

    def __init__(self, autoencoder: Autoencoder, chart: Chart, *, side: int) -> None:
        self.chart = chart
        self.stretch = side / max(autoencoder.height, autoencoder.width)
        height, width = (max(1, round(self.stretch * n)) for n in (autoencoder.height, autoencoder.width))
        stretch = (width / autoencoder.width, height / autoencoder.height)
        self.drawer = OnePicture(autoencoder.gaussians, height=height, width=width, stretch=stretch)

    def draw(self, q: Float64[np.ndarray, " d"]) -> UInt8[np.ndarray, "H W 3"]:
        """The picture at a state."""
        return self.drawer.draw(self.chart.to_raw(q[None])[0])
