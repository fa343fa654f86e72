"""Settings of the chart: how latent coordinates of a frozen autoencoder are whitened and measured."""

from dataclasses import dataclass


@dataclass
class ChartConfig:
    """All settings of the chart; autoencoder, recording and seed come apart."""

    smoothing_frames: float  # sigma of the Gaussian that smooths latents and inputs; 0 for none
    rest_frames: int  # first training frames whose per-pixel median is the rest image
    eigenvalue_floor: float  # smallest latent variance of a coordinate, as a fraction of the largest
    visibility_frames: int  # training frames over which the visibility metric is averaged
    visibility_step: float  # of the finite difference of the decoder, in whitened units
    dimension_frames: int  # training frames the intrinsic dimension is estimated on
    dimension_neighbours: int  # neighbours of each frame in that estimate

    def __post_init__(self) -> None:
        if self.smoothing_frames < 0:
            raise ValueError(
                f"chart.smoothing_frames={self.smoothing_frames} is a standard deviation: 0 (none) or more"
            )
        if not 0 < self.eigenvalue_floor < 1:
            raise ValueError(
                f"chart.eigenvalue_floor={self.eigenvalue_floor} is a fraction of the largest latent "
                "variance: choose it in (0, 1), such as 1e-5"
            )
        if self.visibility_step <= 0:
            raise ValueError(
                f"chart.visibility_step={self.visibility_step} must be a positive length in whitened units"
            )
        if self.dimension_neighbours < 3:
            raise ValueError(
                f"chart.dimension_neighbours={self.dimension_neighbours}: the maximum-likelihood dimension "
                "needs at least 3 neighbours"
            )
        for name in ("rest_frames", "visibility_frames", "dimension_frames"):
            if getattr(self, name) < 1:
                raise ValueError(f"chart.{name}={getattr(self, name)} must be at least 1 frame")
