"""Settings of the key-point forecaster. Torch-free: planning stays fast."""

from dataclasses import dataclass

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
            _require(f"motion.{name}", getattr(self, name), getattr(self, name) >= 1, "must be at least 1")
        fits = self.neighbours <= self.key_points
        _require("motion.neighbours", self.neighbours, fits, f"exceeds motion.key_points={self.key_points}")
        for name in ("feature_weight", "place_noise", "feature_penalty"):
            _require(f"motion.{name}", getattr(self, name), getattr(self, name) >= 0, "must not be negative")


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
            _require(f"rate.{name}", value, len(value) == 2 and min(value) > 0, "is [first, last], positive")
        for name in ("colour", "opacity", "scale", "blend"):
            _require(f"rate.{name}", getattr(self, name), getattr(self, name) > 0, "must be positive")


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
            _require(f"graph.{name}", getattr(self, name), getattr(self, name) >= 1, "must be at least 1")
        _require(
            "graph.batch", self.batch, self.batch >= 2, "must be at least 2: it is normalised by its own mean"
        )
        positive = len(self.rate) == 2 and min(self.rate) > 0
        _require("graph.rate", self.rate, positive, "is [first, last], positive")
        _require("graph.noise", self.noise, self.noise >= 0, "must not be negative")
        share = 0 < self.noise_until <= 1
        _require("graph.noise_until", self.noise_until, share, "is a fraction of the training: in (0, 1]")


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
        _require("n_gaussians", self.n_gaussians, enough, rule)
        known = set(self.steps) == set(PHASES) and min(self.steps.values()) >= 1
        _require("steps", self.steps, known, f"needs at least 1 for each of {', '.join(PHASES)}")
        _require("opacity", self.opacity, 0 < self.opacity < 1, "must lie strictly between 0 and 1")
        _require("spatial_sigma", self.spatial_sigma, self.spatial_sigma > 0, "must be positive")
        weights = min(self.l1, self.ssim) >= 0 and self.l1 + self.ssim > 0
        _require("l1", self.l1, weights, f"and ssim={self.ssim} must not be negative, nor both be zero")

    @property
    def n_steps(self) -> int:
        """Steps of all phases."""
        return sum(self.steps[name] for name in PHASES)


def _require(key: str, value: object, holds: bool, rule: str) -> None:
    if not holds:
        raise ValueError(
            f"forecaster.{key}={value} {rule}; set it in conf/forecaster or with forecaster.{key}=..."
        )
