"""Settings of stage 1: the autoencoder, its training, and the decoders compared with it. Torch-free."""

from dataclasses import dataclass


@dataclass
class LossConfig:
    """Weights and parameters of the four terms of the reconstruction loss.

    Source: paper eq. (recon_loss) and Implementation Details.
    """

    l1: float
    ssim: float
    nonlocal_filter: float
    anisotropy: float
    ssim_window: int  # side of the Gaussian window [px], odd
    anisotropy_limit: float  # ratio of the axes of a drawn ellipse above which the penalty starts

    def __post_init__(self) -> None:
        weights = (self.l1, self.ssim, self.nonlocal_filter, self.anisotropy)
        if min(weights) < 0 or self.l1 + self.ssim <= 0:
            raise ValueError(
                f"stage1.loss weights are l1={self.l1}, ssim={self.ssim}, "
                f"nonlocal_filter={self.nonlocal_filter}, anisotropy={self.anisotropy}; "
                "none may be negative and l1 + ssim must be positive, else nothing draws the frames"
            )
        if self.ssim_window < 1 or self.ssim_window % 2 == 0:
            raise ValueError(
                f"stage1.loss.ssim_window={self.ssim_window} must be an odd number of pixels, at least 1"
            )
        if self.anisotropy_limit < 1:
            raise ValueError(
                f"stage1.loss.anisotropy_limit={self.anisotropy_limit} is a ratio of axes: at least 1"
            )


@dataclass
class RateConfig:
    """Adam step sizes. A centre is in pixels and needs far larger steps than a logit."""

    encoder: float
    latent_step: float | None  # largest move of the latents in one step, over their spread; null for none
    center: float  # spatial centres and their couplings to the latent [px]
    gaussian: float  # every other parameter of a Gaussian
    warmup_steps: int
    final_fraction: float  # of the rate, reached at the last step on a cosine; 1 keeps it constant
    gradient_clip: float | None  # global norm, encoder and Gaussians separately

    def __post_init__(self) -> None:
        if min(self.encoder, self.center, self.gaussian) <= 0:
            raise ValueError("stage1.rate.encoder, .center and .gaussian must be positive step sizes")
        if self.latent_step is not None and self.latent_step <= 0:
            raise ValueError(
                f"stage1.rate.latent_step={self.latent_step} must be positive, or null for no cap"
            )
        if not 0 < self.final_fraction <= 1:
            raise ValueError(f"stage1.rate.final_fraction={self.final_fraction} must lie in (0, 1]")


@dataclass
class InitConfig:
    """Initial values of the parameters."""

    encoder: str  # 'unfolded': `initialize_encoder`, latents along the motion; 'plain': torch's default
    spatial_sigma: float  # of a Gaussian, as a fraction of the image height
    latent_sigma: float  # of a Gaussian, in units of the encoded spread
    opacity: float
    background: str  # 'learned' or 'black'

    def __post_init__(self) -> None:
        if self.encoder not in ("unfolded", "plain"):
            raise ValueError(f"stage1.init.encoder={self.encoder!r}: choose 'unfolded' or 'plain'")
        if self.background not in ("learned", "black"):
            raise ValueError(f"stage1.init.background={self.background!r}: choose 'learned' or 'black'")
        if not 0 < self.opacity < 1:
            raise ValueError(f"stage1.init.opacity={self.opacity} must lie strictly between 0 and 1")
        if min(self.spatial_sigma, self.latent_sigma) <= 0:
            raise ValueError("stage1.init.spatial_sigma and .latent_sigma must be positive")


@dataclass
class LifecycleConfig:
    """When and how an invisible Gaussian is recycled."""

    every: int  # steps between two reviews; 0 switches the lifecycle off
    start: float  # fraction of the run before which no Gaussian is recycled
    stop: float  # fraction of the run after which no Gaussian is recycled
    peak_opacity: float  # a Gaussian whose opacity stays below this over the whole clip is recycled
    split_share: float  # of the recycled that split a parent; the others are teleported to large errors

    def __post_init__(self) -> None:
        if self.every < 0:
            raise ValueError(f"stage1.lifecycle.every={self.every} must be 0 (off) or a number of steps")
        if not 0 <= self.start <= self.stop <= 1:
            raise ValueError(
                f"stage1.lifecycle.start={self.start} and .stop={self.stop} are fractions of the run "
                "with 0 <= start <= stop <= 1"
            )
        if not 0 <= self.split_share <= 1:
            raise ValueError(f"stage1.lifecycle.split_share={self.split_share} must lie in [0, 1]")


@dataclass
class RenderConfig:
    """A second, finer decoder over the frozen chart; other settings are those of stage 1.

    Source: paper, Implementation Details (high-resolution renders).
    """

    factor: float  # times the recorded resolution, in height and width
    n_gaussians: int
    steps: int
    batch: int

    def __post_init__(self) -> None:
        if self.factor <= 1:
            raise ValueError(
                f"render.factor={self.factor} must exceed 1: at the recorded resolution the trained decoder "
                "serves; take render=none"
            )
        if min(self.n_gaussians, self.steps, self.batch) < 1:
            raise ValueError(
                f"render.n_gaussians={self.n_gaussians}, render.steps={self.steps} and "
                f"render.batch={self.batch} must be at least 1"
            )


@dataclass
class Stage1Config:
    """All settings that determine the result of stage 1, except the recording and the seed."""

    d: int
    n_gaussians: int
    kernel: int  # side of the encoder's filters [px]
    channels: int
    steps: int
    batch: int  # frames a step
    backend: str  # rasteriser: 'auto', 'numba', 'torch' or 'gsplat'
    checkpoint_every_s: float
    loss: LossConfig
    rate: RateConfig
    init: InitConfig
    lifecycle: LifecycleConfig

    def __post_init__(self) -> None:
        counts = {
            "d": self.d,
            "n_gaussians": self.n_gaussians,
            "channels": self.channels,
            "steps": self.steps,
            "batch": self.batch,
        }
        for name, value in counts.items():
            if value < 1:
                raise ValueError(f"stage1.{name}={value} must be at least 1")
        if self.kernel < 2 or self.kernel % 2:
            raise ValueError(
                f"stage1.kernel={self.kernel} must be even, so that stride 2 halves the image exactly"
            )


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class FieldConfig:
    """A decoder whose Gaussians a network of the latent moves, and the training schedule of both decoders.

    Source: paper, Appendix "Deformation-Field Decoder at Equal Budget".
    """

    n_gaussians: int
    hidden: int  # width of the two hidden layers
    shift_limit: float  # largest shift of a centre, in half widths of the image
    shape_limit: float  # largest change of the logarithm of a size
    steps: int
    batch: int  # frames a step
    neighbours: int  # whose velocities a Gaussian's is compared with

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
