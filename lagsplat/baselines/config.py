"""Settings of the baselines: what they are and how they are trained. Torch-free: planning stays fast."""

from dataclasses import dataclass

DECODERS = ("deconv", "abcd")
LAWS = ("oscillators", "koopman")
ORDERS = ("sequential", "shuffled")


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class BaselineLossConfig:
    """Weights of the terms beside the reconstruction of a frame by itself, which has weight one."""

    divergence: float  # of the encoded distribution from the unit normal one
    ahead: float  # the next frame, drawn at the state after one step
    latent: float  # that state and its velocity times the step, against the encoded ones
    steady: float  # oscillators: frames at rest lie at the rest and stay there
    attention: float  # attention: maps change only where the image does
    closing: float  # paired oscillators: nodes approach each other as their maps do
    closing_early: float  # the same during `closing_from`
    closing_from: float  # fraction of the run
    closing_gradient: float  # share of the last term's gradient that reaches the maps

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value < 0:
                raise ValueError(f"baseline.loss.{name}={value} must not be negative")
        if self.closing_from > 1:
            raise ValueError(f"baseline.loss.closing_from={self.closing_from} is a fraction of the run")


@dataclass  # not frozen, for the same reason
class BaselineRateConfig:
    """AdamW step size along a run, whose warm-up concerns the encoder and the law only."""

    peak: float
    weight_decay: float
    warmup: float  # fraction of the run
    warmup_stairs: int  # equal stairs from `warmup_start` up to, not including, one
    warmup_start: float
    drop_at: float  # fraction of the run, the warm-up not counted, after which the rate is lower
    drop_factor: float
    gradient_clip: float  # norm of all gradients together

    def __post_init__(self) -> None:
        if min(self.peak, self.gradient_clip, self.drop_factor, self.warmup_start) <= 0:
            raise ValueError(
                "baseline.rate.peak, .gradient_clip, .drop_factor and .warmup_start must be positive"
            )
        if not (0 <= self.warmup < 1 and 0 < self.drop_at <= 1):
            raise ValueError(
                f"baseline.rate.warmup={self.warmup} and .drop_at={self.drop_at} are fractions of the run"
            )
        if self.weight_decay < 0 or self.warmup_stairs < 1:
            raise ValueError(
                f"baseline.rate.weight_decay={self.weight_decay} must not be negative and "
                f".warmup_stairs={self.warmup_stairs} must be at least 1"
            )


@dataclass  # not frozen, for the same reason
class BaselineConfig:
    """Everything that decides a baseline, less the recording and the seed."""

    decoder: str  # 'deconv' or 'abcd'
    dynamics: str  # 'oscillators' or 'koopman'
    d: int
    samples: int  # inputs that the law is fed, this frame's and earlier ones
    background: float  # logit of the background, of the attention decoder
    noise: float  # Gumbel noise on the logits in training, in spreads of them
    rest_frames: int  # leading frames of the recording in which the mechanism is at rest
    steps: dict[str, int]  # by decoder: one with attention costs ten times as much a step
    batch: int  # consecutive frames a step
    order: str  # of the batches: 'sequential' or 'shuffled' anew on every pass
    checkpoint_every_s: float
    loss: BaselineLossConfig
    rate: BaselineRateConfig
    weights: str | None
    """Published weights in place of training: a file, or a folder with ``SYSTEM/BASELINE.pt``."""

    def __post_init__(self) -> None:
        for name, value, known in (
            ("decoder", self.decoder, DECODERS),
            ("dynamics", self.dynamics, LAWS),
            ("order", self.order, ORDERS),
        ):
            if value not in known:
                raise ValueError(f"baseline.{name}={value!r}: choose one of {', '.join(known)}")
        if set(self.steps) != set(DECODERS) or min(self.steps.values()) < 1:
            raise ValueError(
                f"baseline.steps={self.steps}: give a number of steps, at least 1, for each of "
                f"{', '.join(DECODERS)}"
            )
        for name in ("d", "samples", "rest_frames"):
            if getattr(self, name) < 1:
                raise ValueError(f"baseline.{name}={getattr(self, name)} must be at least 1")
        if self.batch < 3:
            raise ValueError(f"baseline.batch={self.batch}: a rate of change in a batch needs three frames")
        if self.noise < 0:
            raise ValueError(f"baseline.noise={self.noise} must not be negative")
        if (self.decoder, self.dynamics) == ("abcd", "oscillators") and self.d % 2:
            raise ValueError(
                f"baseline.d={self.d}: oscillators drawn by attention are planar nodes; d must be even"
            )

    @property
    def n_steps(self) -> int:
        """Steps of this model's training."""
        return self.steps[self.decoder]
