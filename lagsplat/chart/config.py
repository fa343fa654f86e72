"""Settings of the chart: how latent coordinates of a frozen autoencoder are whitened and measured."""

from dataclasses import dataclass

from lagsplat.setting_checks import require_least, require_positive, require_setting


@dataclass
class ChartConfig:
    """All settings of the chart; autoencoder, recording and seed come apart."""

    smoothing_frames: float  # sigma of the Gaussian that smooths latents and inputs; 0 for none
    rest_frames: int  # first training frames whose per-pixel median is the rest image
    eigenvalue_floor: float  # smallest latent variance of a coordinate, as a fraction of the largest
    visibility_frames: int  # training frames over which the visibility metric is averaged
    visibility_step: float  # of the finite difference of the decoder, in whitened units
    refinement_steps: int  # by which the decoder corrects the encoder's latents; the paper takes none
    dimension_frames: int  # training frames the intrinsic dimension is estimated on
    dimension_neighbours: int  # neighbours of each frame in that estimate

    def __post_init__(self) -> None:
        require_least(self, "chart", 0, "smoothing_frames", "refinement_steps")
        floor = self.eigenvalue_floor
        rule = "is a fraction of the largest latent variance: choose it in (0, 1), such as 1e-5"
        require_setting("chart.eigenvalue_floor", floor, 0 < floor < 1, rule)
        require_positive(self, "chart", "visibility_step")
        require_least(self, "chart", 3, "dimension_neighbours")
        require_least(self, "chart", 1, "rest_frames", "visibility_frames", "dimension_frames")
