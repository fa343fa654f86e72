"""Settings of the comparison of two decoders at an equal number of Gaussians. Torch-free."""

from dataclasses import dataclass


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class FieldConfig:
    """A decoder whose Gaussians a network of the latent moves, and the schedule of both decoders.

    Raises:
        ValueError: a value outside its domain.

    Source: paper, Appendix "Deformation-Field Decoder at Equal Budget".
    """

    n_gaussians: int
    hidden: int  # width of the two hidden layers
    shift_limit: float  # farthest shift of a centre, in half widths of the image
    shape_limit: float  # largest change of the logarithm of a size
    steps: int
    batch: int  # frames a step
    neighbours: int  # whose velocities a Gaussian's is held against

    def __post_init__(self) -> None:
        """Check the domains."""
        for key, value in vars(self).items():
            if value <= 0:
                raise ValueError(
                    f"deformation.{key}={value} must be positive; set it in conf/deformation or with "
                    f"deformation.{key}=..."
                )
        if self.neighbours >= self.n_gaussians:
            raise ValueError(
                f"deformation.neighbours={self.neighbours} must be fewer than "
                f"deformation.n_gaussians={self.n_gaussians}"
            )
