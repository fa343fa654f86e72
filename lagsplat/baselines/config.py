"""Settings of the baselines: their architecture and their training. Torch-free, so that planning is fast."""

from dataclasses import dataclass

DECODERS = ("deconv", "abcd")
LAWS = ("oscillators", "koopman")
ORDERS = ("sequential", "shuffled")
BASELINE_TITLES = {
    "osc_deconv": "Osc. + deconv",
    "osc_abcd": "Osc. + ABCD",
    "koopman_deconv": "Koopman + deconv",
    "koopman_abcd": "Koopman + ABCD",
}
"""Names of the choices of ``conf/baseline`` in tables and figures."""


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class BaselineLossConfig:
    """Weights of the loss terms; the reconstruction of single frames has weight one."""

    divergence: float  # KL divergence of the encoded distribution from the standard normal
    ahead: float  # the next frame, rendered at the state after one step
    latent: float  # that state and its velocity times the step, against the encoded ones
    steady: float  # oscillators: frames at rest lie at the rest state and stay there
    attention: float  # attention: maps change only where the image does
    closing: float  # paired oscillators: nodes approach each other at the rate of their maps
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
    """AdamW step size over a run; the warm-up applies to the encoder and the dynamics only."""

    peak: float
    weight_decay: float
    warmup: float  # fraction of the run
    warmup_stairs: int  # equal steps from `warmup_start` up to, not including, one
    warmup_start: float
    drop_at: float  # fraction of the run, without the warm-up, after which the rate is lower
    drop_factor: float
    gradient_clip: float  # of the norm of all gradients together

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
    """All settings of a baseline; recording and seed come apart."""

    decoder: str  # 'deconv' or 'abcd'
    dynamics: str  # 'oscillators' or 'koopman'
    d: int
    samples: int  # inputs that the dynamics see, this frame's and earlier ones
    background: float  # logit of the background of the attention decoder
    noise: float  # Gumbel noise on the logits in training, in standard deviations of them
    rest_frames: int  # leading frames of the recording in which the mechanism is at rest
    steps: dict[str, int]  # by decoder: a step with attention costs ten times as much
    batch: int  # consecutive frames per step
    order: str  # of the batches: 'sequential', or 'shuffled' on every pass
    checkpoint_every_s: float
    loss: BaselineLossConfig
    rate: BaselineRateConfig
    weights: str | None
    """Published weights instead of training: a file, or a folder with ``SYSTEM/BASELINE.pt``."""

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
        """Number of training steps for this decoder."""
        return self.steps[self.decoder]


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class AuthorsConfig:
    """A checkout of GaussianPrediction and its Python, or frames that it predicted elsewhere.

    Raises:
        ValueError: a value outside its domain, or a checkout and frames at once.
    """

    checkout: str | None  # folder with train.py and train_GCN.py; null skips the tool
    python: str | None  # its interpreter, with its own CUDA build of torch
    frames: str | None  # folder of predicted PNGs in place of a checkout
    iterations: int
    epochs: int  # of the graph network
    free_frames: int  # predicted freely after the held-out frames
    field_of_view_rad: float  # horizontal, of the single declared camera
    distance: float  # of that camera from the origin, in the tool's units
    extent: float  # of the scene: the tool derives it from the distances of cameras, and there is only one

    def __post_init__(self) -> None:
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


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class OdeConfig:
    """All settings of a neural ODE; chart and seed come apart.

    Raises:
        ValueError: a value outside its domain.
    """

    hidden: int
    layers: int  # hidden layers
    method: str  # of torchdiffeq, one step a frame: 'rk4' or 'midpoint'
    steps: int
    batch: int  # windows per step
    periods: float  # final length of a window in natural periods; it starts at a quarter of this
    rate: float  # Adam
    final_fraction: float  # of the rate, reached at the last step on a cosine
    gradient_clip: float
    checkpoint_every_s: float

    def __post_init__(self) -> None:
        for name in ("hidden", "layers", "steps", "batch"):
            _require_ode(name, getattr(self, name), getattr(self, name) >= 1, "must be at least 1")
        for name in ("periods", "rate", "gradient_clip"):
            _require_ode(name, getattr(self, name), getattr(self, name) > 0, "must be positive")
        _require_ode("method", self.method, self.method in ("rk4", "midpoint"), "must be rk4 or midpoint")
        share = 0 < self.final_fraction <= 1
        _require_ode("final_fraction", self.final_fraction, share, "must lie in (0, 1]")


def _require_ode(key: str, value: object, holds: bool, rule: str) -> None:
    if not holds:
        raise ValueError(f"ode.{key}={value} {rule}; set it in conf/ode or with ode.{key}=...")


PHASES = ("warm_up", "free", "keys", "joint", "graph")


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class MotionConfig:
    """The network that moves the Gaussians, from their features, places and the time."""

    feature: int  # dimension of the motion feature
    octaves: int  # of sines and cosines, for place and time
    hidden: int
    layers: int  # hidden layers
    key_points: int
    neighbours: int  # key points that move one Gaussian
    feature_weight: float  # weight of a feature against a place in the search for neighbours
    place_noise: float  # sigma of the noise on the places that the network sees [half widths]
    feature_penalty: float  # weight of a feature's mean absolute value in the loss

    def __post_init__(self) -> None:
        counts = ("feature", "octaves", "hidden", "layers", "key_points", "neighbours")
        for name in counts:
            _require_forecaster(
                f"motion.{name}", getattr(self, name), getattr(self, name) >= 1, "must be at least 1"
            )
        fits = self.neighbours <= self.key_points
        _require_forecaster(
            "motion.neighbours", self.neighbours, fits, f"exceeds motion.key_points={self.key_points}"
        )
        for name in ("feature_weight", "place_noise", "feature_penalty"):
            _require_forecaster(
                f"motion.{name}", getattr(self, name), getattr(self, name) >= 0, "must not be negative"
            )


@dataclass  # not frozen, for the same reason
class ForecasterRateConfig:
    """Adam step sizes: first and last, falling by a constant factor per step."""

    motion: list[float]  # network, features and key points
    place: list[float]  # of the Gaussians, in half widths
    colour: float
    opacity: float
    scale: float  # of log-scales and angles
    blend: float  # logits by which key points share a Gaussian

    def __post_init__(self) -> None:
        for name in ("motion", "place"):
            value = getattr(self, name)
            _require_forecaster(
                f"rate.{name}", value, len(value) == 2 and min(value) > 0, "is [first, last], positive"
            )
        for name in ("colour", "opacity", "scale", "blend"):
            _require_forecaster(
                f"rate.{name}", getattr(self, name), getattr(self, name) > 0, "must be positive"
            )


@dataclass  # not frozen, for the same reason
class GraphConfig:
    """The graph networks that predict key points, one for positions and one for rotations."""

    history: int  # frames that a prediction uses
    hidden: int
    blocks: int  # residual blocks of two graph convolutions
    batch: int
    rate: list[float]  # Adam, first and last, on a half cosine
    noise: float  # uniform, on the input positions [half widths]; half of it on the rotations
    noise_until: float  # fraction of the training over which the noise falls to zero

    def __post_init__(self) -> None:
        for name in ("history", "hidden", "blocks"):
            _require_forecaster(
                f"graph.{name}", getattr(self, name), getattr(self, name) >= 1, "must be at least 1"
            )
        _require_forecaster(
            "graph.batch", self.batch, self.batch >= 2, "must be at least 2: it is normalised by its own mean"
        )
        positive = len(self.rate) == 2 and min(self.rate) > 0
        _require_forecaster("graph.rate", self.rate, positive, "is [first, last], positive")
        _require_forecaster("graph.noise", self.noise, self.noise >= 0, "must not be negative")
        share = 0 < self.noise_until <= 1
        _require_forecaster(
            "graph.noise_until", self.noise_until, share, "is a fraction of the training: in (0, 1]"
        )


@dataclass  # not frozen, for the same reason
class ForecasterConfig:
    """All settings of a key-point forecaster; recording and seed come apart."""

    n_gaussians: int
    spatial_sigma: float  # initial size of a Gaussian, as a fraction of the image height
    opacity: float  # initial opacity of a Gaussian
    l1: float
    ssim: float
    ssim_window: int
    steps: dict[str, int]  # of each phase, see `PHASES`
    backend: str  # rasteriser: 'auto', 'numba' or 'torch'
    checkpoint_every_s: float
    motion: MotionConfig
    rate: ForecasterRateConfig
    graph: GraphConfig

    def __post_init__(self) -> None:
        enough = self.n_gaussians >= self.motion.key_points
        rule = f"must be at least motion.key_points={self.motion.key_points}"
        _require_forecaster("n_gaussians", self.n_gaussians, enough, rule)
        known = set(self.steps) == set(PHASES) and min(self.steps.values()) >= 1
        _require_forecaster("steps", self.steps, known, f"needs at least 1 for each of {', '.join(PHASES)}")
        _require_forecaster(
            "opacity", self.opacity, 0 < self.opacity < 1, "must lie strictly between 0 and 1"
        )
        _require_forecaster("spatial_sigma", self.spatial_sigma, self.spatial_sigma > 0, "must be positive")
        weights = min(self.l1, self.ssim) >= 0 and self.l1 + self.ssim > 0
        _require_forecaster(
            "l1", self.l1, weights, f"and ssim={self.ssim} must not be negative, nor both be zero"
        )

    @property
    def n_steps(self) -> int:
        """Steps of all phases together."""
        return sum(self.steps[name] for name in PHASES)


def _require_forecaster(key: str, value: object, holds: bool, rule: str) -> None:
    if not holds:
        raise ValueError(
            f"forecaster.{key}={value} {rule}; set it in conf/forecaster or with forecaster.{key}=..."
        )
