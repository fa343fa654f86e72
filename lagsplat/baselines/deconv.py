"""The deconvolutional decoder: every pixel from the whole state."""

from torch import Tensor, nn
from torch.nn import functional

from lagsplat.baselines.encoder import REDUCTION, SLOPE, WIDTHS
from lagsplat.shapes import Images, Latents


class DeconvDecoder(nn.Module):
    """One linear map and three transposed convolutions of kernel 4 and stride 2, ending in a sigmoid.

    There is no activation after the linear map. It gives no coordinate a place in the image.
    """

    def __init__(self, d: int, *, height: int, width: int) -> None:
        super().__init__()
        self.cells = (height // REDUCTION, width // REDUCTION)
        self.expand = nn.Linear(d, WIDTHS[3] * self.cells[0] * self.cells[1])
        self.convolutions = nn.ModuleList(
            nn.ConvTranspose2d(n_in, n_out, 4, stride=2, padding=1)
            for n_in, n_out in ((WIDTHS[3], WIDTHS[2]), (WIDTHS[2], WIDTHS[1]), (WIDTHS[1], WIDTHS[0]))
        )

    def forward(self, z: Latents) -> Images:
        """Images in [0, 1]."""
        hidden: Tensor = self.expand(z).unflatten(1, (WIDTHS[3], *self.cells))
        first, second, last = self.convolutions
        hidden = functional.leaky_relu(first(hidden), SLOPE)
        hidden = functional.leaky_relu(second(hidden), SLOPE)
        return last(hidden).sigmoid()
