"""Where the authors' tool is and how long it is trained. Torch-free: planning stays fast."""

from dataclasses import dataclass


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class AuthorsConfig:
    """A checkout of GaussianPrediction and its Python, or the frames that it predicted elsewhere.

    Raises:
        ValueError: a value outside its domain, or a checkout and frames at once.
    """

    checkout: str | None  # folder with train.py and train_GCN.py; null leaves the tool out
    python: str | None  # its interpreter, with its own CUDA build of torch
    frames: str | None  # folder of predicted PNGs in place of a checkout
    iterations: int
    epochs: int  # of the graph network
    free_frames: int  # predicted freely after the held-out ones
    field_of_view_rad: float  # horizontal, of the one declared camera
    distance: float  # of that camera from the origin, in the tool's own units
    extent: float  # of the scene: the tool takes it from how far cameras are apart, and one camera has none

    def __post_init__(self) -> None:
        """Check the domains."""
        for key in ("iterations", "epochs", "free_frames", "field_of_view_rad", "distance", "extent"):
            if getattr(self, key) <= 0:
                raise ValueError(f"authors.{key}={getattr(self, key)} must be positive; see conf/authors")
        if self.checkout is not None and self.frames is not None:
            raise ValueError("authors.checkout and authors.frames: give one of them, the other null")
        if self.checkout is not None and self.python is None:
            raise ValueError(
                f"authors.checkout={self.checkout} needs authors.python=INTERPRETER of the tool's own "
                "environment, since its CUDA packages are not this project's"
            )
