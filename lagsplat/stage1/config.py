"""Settings of stage 1: the autoencoder, its training, and the decoders compared with it. Torch-free."""

from dataclasses import dataclass

from lagsplat import setting_checks as check


@dataclass
class LossConfig:
    """Weights and parameters of the terms of the reconstruction loss.

    Source: paper eq. (recon_loss) and Implementation Details; ``linear_response`` is this project's.
    """

    l1: float
    ssim: float
    nonlocal_filter: float
    anisotropy: float
    linear_response: float  # of the departure from it, relative to what it leaves open; driven motions alone
    ssim_window: int  # side of the Gaussian window [px], odd
    anisotropy_limit: float  # ratio of the axes of a drawn ellipse above which the penalty starts

    def __post_init__(self) -> None:
        check.require_least(
            self, "stage1.loss", 0, "l1", "ssim", "nonlocal_filter", "anisotropy", "linear_response"
        )
        rule = f"and ssim={self.ssim} are both zero, so nothing draws the frames"
        check.require_setting("stage1.loss.l1", self.l1, self.l1 + self.ssim > 0, rule)
        odd = self.ssim_window > 0 and self.ssim_window % 2 == 1
        check.require_setting("stage1.loss.ssim_window", self.ssim_window, odd, "must be odd and positive")
        check.require_least(self, "stage1.loss", 1, "anisotropy_limit")


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
        check.require_positive(self, "stage1.rate", "encoder", "center", "gaussian")
        valid = self.latent_step is None or self.latent_step > 0
        check.require_setting("stage1.rate.latent_step", self.latent_step, valid, "must be positive, or null")
        check.require_interval(self, "stage1.rate", "(0, 1]", "final_fraction")


@dataclass
class InitConfig:
    """Initial values of the parameters."""

    encoder: str  # 'unfolded': `initialize_encoder`, latents along the motion; 'plain': torch's default
    spatial_sigma: float  # of a Gaussian, as a fraction of the image height
    latent_sigma: float  # of a Gaussian, in units of the encoded spread
    opacity: float
    background: str  # 'learned' or 'black'

    def __post_init__(self) -> None:
        check.require_choice(self, "stage1.init", "encoder", ("unfolded", "plain"))
        check.require_choice(self, "stage1.init", "background", ("learned", "black"))
        check.require_interval(self, "stage1.init", "(0, 1)", "opacity")
        check.require_positive(self, "stage1.init", "spatial_sigma", "latent_sigma")


@dataclass
class LifecycleConfig:
    """When and how an invisible Gaussian is recycled."""

    every: int  # steps between two reviews; 0 switches the lifecycle off
    start: float  # fraction of the run before which no Gaussian is recycled
    stop: float  # fraction of the run after which no Gaussian is recycled
    peak_opacity: float  # a Gaussian whose opacity stays below this over the whole clip is recycled
    split_share: float  # of the recycled that split a parent; the others are teleported to large errors

    def __post_init__(self) -> None:
        check.require_least(self, "stage1.lifecycle", 0, "every")
        check.require_interval(self, "stage1.lifecycle", "[0, 1]", "start", "stop", "split_share")
        rule = f"must not exceed stage1.lifecycle.stop={self.stop}"
        check.require_setting("stage1.lifecycle.start", self.start, self.start <= self.stop, rule)


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
        rule = "must exceed 1 (render=none draws with the trained decoder, at the recorded resolution)"
        check.require_setting("render.factor", self.factor, self.factor > 1, rule)
        check.require_least(self, "render", 1, "n_gaussians", "steps", "batch")

    def fine_size(self, height: int, width: int) -> tuple[int, int]:
        """Height and width of the finer frames [px]."""
        return round(self.factor * height), round(self.factor * width)


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
    refinement_steps: int  # Gauss-Newton steps by which the decoder corrects the encoder's latents afterwards
    loss: LossConfig
    rate: RateConfig
    init: InitConfig
    lifecycle: LifecycleConfig

    def __post_init__(self) -> None:
        check.require_least(self, "stage1", 1, "d", "n_gaussians", "channels", "steps", "batch")
        check.require_least(self, "stage1", 0, "refinement_steps")
        even = self.kernel > 0 and self.kernel % 2 == 0
        rule = "must be even and positive, so that stride 2 halves the image exactly"
        check.require_setting("stage1.kernel", self.kernel, even, rule)


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class PlanarDecoderConfig:
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
        check.require_positive(self, "deformation", *vars(self))
        few = self.neighbours < self.n_gaussians
        rule = f"must be fewer than deformation.n_gaussians={self.n_gaussians}"
        check.require_setting("deformation.neighbours", self.neighbours, few, rule)
