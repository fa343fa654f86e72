"""Settings of the baselines: their architecture and their training. Torch-free, so that planning is fast.

Dataclasses are not frozen: OmegaConf turns frozen ones into read-only nodes.
"""

from dataclasses import dataclass

from lagsplat import setting_checks as check

DECODERS = ("deconv", "abcd")
BASELINE_TITLES = {
    "osc_deconv": "Osc. + deconv",
    "osc_abcd": "Osc. + ABCD",
    "koopman_deconv": "Koopman + deconv",
    "koopman_abcd": "Koopman + ABCD",
}
"""Names of the choices of ``conf/baseline`` in tables and figures."""


@dataclass
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
        check.require_least(self, "baseline.loss", 0, *vars(self))
        check.require_interval(self, "baseline.loss", "[0, 1]", "closing_from")


@dataclass
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
        check.require_positive(self, "baseline.rate", "peak", "gradient_clip", "drop_factor", "warmup_start")
        check.require_least(self, "baseline.rate", 0, "weight_decay")
        check.require_least(self, "baseline.rate", 1, "warmup_stairs")
        check.require_interval(self, "baseline.rate", "[0, 1)", "warmup")
        check.require_interval(self, "baseline.rate", "(0, 1]", "drop_at")


@dataclass
class BaselineValidationConfig:
    """Forecasts of a part that is kept from training, by which the weights are chosen."""

    share: float  # the end of the training part, as a share of it; with 0 the last weights are taken
    checks: int  # how often over the run
    starts: int  # forecasts of half a second at each

    def __post_init__(self) -> None:
        check.require_interval(self, "baseline.validation", "[0, 1)", "share")
        check.require_least(self, "baseline.validation", 1, "checks", "starts")


@dataclass
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
    validation: BaselineValidationConfig
    weights: str | None
    """Published weights instead of training: a file, or a folder with ``SYSTEM/BASELINE.pt``."""

    def __post_init__(self) -> None:
        check.require_choice(self, "baseline", "decoder", DECODERS)
        check.require_choice(self, "baseline", "dynamics", ("oscillators", "koopman"))
        check.require_choice(self, "baseline", "order", ("sequential", "shuffled"))
        _require_steps("baseline", self.steps, DECODERS)
        check.require_least(self, "baseline", 1, "d", "samples", "rest_frames")
        rule = "is too small: a rate of change in a batch needs three frames"
        check.require_setting("baseline.batch", self.batch, self.batch >= 3, rule)
        check.require_least(self, "baseline", 0, "noise")
        planar = (self.decoder, self.dynamics) == ("abcd", "oscillators")
        rule = "must be even: oscillators with an attention decoder are planar nodes"
        check.require_setting("baseline.d", self.d, not planar or self.d % 2 == 0, rule)

    @property
    def n_steps(self) -> int:
        """Number of training steps for this decoder."""
        return self.steps[self.decoder]


@dataclass
class AuthorsConfig:
    """A checkout of GaussianPrediction and its Python, or frames that it predicted elsewhere."""

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
        check.require_positive(self, "authors", "iterations", "epochs", "free_frames")
        check.require_positive(self, "authors", "field_of_view_rad", "distance", "extent")
        if self.checkout is not None and self.frames is not None:
            raise ValueError("authors.checkout and authors.frames: give one of them, the other null")
        if self.checkout is not None and self.python is None:
            raise ValueError(
                f"authors.checkout={self.checkout} needs authors.python=INTERPRETER of the tool's own "
                "environment, which has its CUDA packages"
            )


ODE_TITLES = {"none": "Neural ODE", "hamiltonian": "Hamiltonian ODE"}
"""Structures of neural differential equations, and their names in tables and figures."""


@dataclass
class OdeConfig:
    """All settings of a neural ODE; chart and seed come apart."""

    structure: str  # what it knows of mechanics: 'none', or 'hamiltonian' with dissipation
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
        check.require_least(self, "ode", 1, "hidden", "layers", "steps", "batch")
        check.require_positive(self, "ode", "periods", "rate", "gradient_clip")
        check.require_choice(self, "ode", "structure", tuple(ODE_TITLES))
        check.require_choice(self, "ode", "method", ("rk4", "midpoint"))
        check.require_interval(self, "ode", "(0, 1]", "final_fraction")


PHASES = ("warm_up", "free", "keys", "joint", "graph")


@dataclass
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
        check.require_least(self, "forecaster.motion", 1, *counts)
        enough = self.key_points >= self.neighbours
        rule = f"must be at least forecaster.motion.neighbours={self.neighbours}"
        check.require_setting("forecaster.motion.key_points", self.key_points, enough, rule)
        check.require_least(self, "forecaster.motion", 0, "feature_weight", "place_noise", "feature_penalty")


@dataclass
class ForecasterRateConfig:
    """Adam step sizes: first and last, falling by a constant factor per step."""

    motion: list[float]  # network, features and key points
    place: list[float]  # of the Gaussians, in half widths
    colour: float
    opacity: float
    scale: float  # of log-scales and angles
    blend: float  # logits by which key points share a Gaussian

    def __post_init__(self) -> None:
        _require_ends("forecaster.rate.motion", self.motion)
        _require_ends("forecaster.rate.place", self.place)
        check.require_positive(self, "forecaster.rate", "colour", "opacity", "scale", "blend")


def _require_steps(group: str, steps: dict[str, int], names: tuple[str, ...]) -> None:
    enough = set(steps) == set(names) and min(steps.values()) >= 1
    check.require_setting(f"{group}.steps", steps, enough, f"needs at least 1 for each of {', '.join(names)}")


def _require_ends(key: str, rates: list[float]) -> None:
    check.require_setting(key, rates, len(rates) == 2 and min(rates) > 0, "is [first, last], positive")


@dataclass
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
        check.require_least(self, "forecaster.graph", 1, "history", "hidden", "blocks")
        rule = "must be at least 2: it is normalised by its own mean"
        check.require_setting("forecaster.graph.batch", self.batch, self.batch >= 2, rule)
        _require_ends("forecaster.graph.rate", self.rate)
        check.require_least(self, "forecaster.graph", 0, "noise")
        check.require_interval(self, "forecaster.graph", "(0, 1]", "noise_until")


@dataclass
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
        rule = f"must be at least forecaster.motion.key_points={self.motion.key_points}"
        check.require_setting("forecaster.n_gaussians", self.n_gaussians, enough, rule)
        _require_steps("forecaster", self.steps, PHASES)
        check.require_interval(self, "forecaster", "(0, 1)", "opacity")
        check.require_positive(self, "forecaster", "spatial_sigma")
        check.require_least(self, "forecaster", 0, "l1", "ssim")
        rule = f"and ssim={self.ssim} are both zero, so nothing draws the frames"
        check.require_setting("forecaster.l1", self.l1, self.l1 + self.ssim > 0, rule)

    @property
    def n_steps(self) -> int:
        """Steps of all phases together."""
        return sum(self.steps[name] for name in PHASES)
