"""Settings of the baselines: what they are and how they are trained. Torch-free: planning stays fast.

Where the authors' tool is and how long it is trained. Torch-free: planning stays fast.

Settings of the free neural differential equation. Torch-free: planning stays fast.

Settings of the key-point forecaster. Torch-free: planning stays fast.
"""

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
"""What tables and figures call the choices of ``conf/baseline``."""


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


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class OdeConfig:
    """Everything that decides a free neural differential equation, less the chart and the seed.

    Raises:
        ValueError: a value outside its domain.
    """

    hidden: int
    layers: int  # hidden ones
    method: str  # of torchdiffeq, one step a frame: 'rk4' or 'midpoint'
    steps: int
    batch: int  # windows a step
    periods: float  # length of a window in natural periods; it grows to this from a quarter
    rate: float  # Adam
    final_fraction: float  # of the rate, reached at the last step on a cosine
    gradient_clip: float
    checkpoint_every_s: float

    def __post_init__(self) -> None:
        """Check the domains."""
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
    """What moves the Gaussians: a network of their own features, places and the time."""

    feature: int  # numbers that tell one moving thing from another
    octaves: int  # of sines and cosines, of the place and of the time alike
    hidden: int
    layers: int  # hidden ones
    key_points: int
    neighbours: int  # key points that move one Gaussian
    feature_weight: float  # of a feature against a place, where neighbours are looked for
    place_noise: float  # sigma of the noise on the places that the network is told, over half a width
    feature_penalty: float  # price of a feature's mean absolute value

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
    """Adam step sizes: first and last, falling by a constant factor a step."""

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
    """The graph networks that carry key points on, one for their positions and one for their turns."""

    history: int  # frames that a prediction is made from
    hidden: int
    blocks: int  # residual, of two graph convolutions
    batch: int
    rate: list[float]  # Adam, first and last, on a half cosine
    noise: float  # uniform, on the input positions [half widths]; half of it on the turns
    noise_until: float  # fraction of the training over which it falls to nothing

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
    """Everything that decides a key-point forecaster, less the recording and the seed."""

    n_gaussians: int
    spatial_sigma: float  # of a Gaussian at the start, as a fraction of the image height
    opacity: float  # of a Gaussian at the start
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
        """Steps of all phases."""
        return sum(self.steps[name] for name in PHASES)


def _require_forecaster(key: str, value: object, holds: bool, rule: str) -> None:
    if not holds:
        raise ValueError(
            f"forecaster.{key}={value} {rule}; set it in conf/forecaster or with forecaster.{key}=..."
        )
