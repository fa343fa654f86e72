"""The encoder that all four baselines share: a small variational one that also differentiates its mean."""

from itertools import pairwise

from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from lagsplat.baselines.tangent import along
from lagsplat.shapes import Images, Latents

SLOPE = 0.2  # of LeakyReLU in the encoder and in both decoders
WIDTHS = (3, 32, 64, 128)
REDUCTION = 8  # three halvings of each side


def require_size(height: int, width: int) -> None:
    """Check that three halvings of each side are whole.

    Raises:
        ValueError: they are not.
    """
    if min(height, width) < REDUCTION or height % REDUCTION or width % REDUCTION:
        raise ValueError(
            f"frames of {height} x {width} pixels: the baselines halve each side three times, so both must "
            f"be multiples of {REDUCTION}; set recording.height and recording.width"
        )


class VariationalEncoder(nn.Module):
    """Three convolutions of kernel 4 and stride 2, and one linear map to a mean and a log-variance.

    ``z`` is the mean everywhere but in the reconstruction of a frame by itself, where it is sampled.
    """

    def __init__(self, d: int, *, height: int, width: int) -> None:
        super().__init__()
        require_size(height, width)
        self.d = d
        self.convolutions = nn.ModuleList(
            nn.Conv2d(n_in, n_out, 4, stride=2, padding=1) for n_in, n_out in pairwise(WIDTHS)
        )
        cells = (height // REDUCTION) * (width // REDUCTION)
        self.head = nn.Linear(WIDTHS[-1] * cells, 2 * d)

    def forward(self, images: Images) -> tuple[Latents, Latents]:
        """Mean and log-variance of each image."""
        hidden: Tensor = images
        for convolution in self.convolutions:
            hidden = functional.leaky_relu(convolution(hidden), SLOPE)
        both = self.head(hidden.flatten(1))
        return both[:, : self.d], both[:, self.d :]

    def moving(self, images: Images, rates: Float[Tensor, "B 3 H W"]) -> tuple[Latents, Latents, Latents]:
        """Mean, log-variance, and the velocity [1/s] of the mean while the image changes by ``rates`` [1/s].

        The velocity is the Jacobian of the mean times ``rates``, exact and of one pass.
        """
        (mean, log_variance), (velocity, _) = along(self.forward, images, rates)
        return mean, log_variance, velocity
