"""Settings of evaluation and of extrapolation past the training window. Torch-free for fast planning."""

from dataclasses import dataclass

from lagsplat.setting_checks import require_least, require_positive, require_setting


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class FigureConfig:
    """The rollout that is drawn, and the rollouts behind the figure of errors over time.

    Source: paper, the figures of rollouts.
    """

    start: str
    """``held_out``: at the first scored frame of the longest held-out clip; ``boundary``: in the training
    part, so that the rollout crosses into the held-out end of the same clip.
    """
    duration_s: float  # longest rollout drawn; a clip's end cuts it
    horizon_s: float  # length of the rollouts whose error is drawn over time; half the longest clip cuts it
    horizon_starts: int  # number of these rollouts

    def __post_init__(self) -> None:
        known = self.start in ("held_out", "boundary")
        require_setting("evaluate.figure.start", self.start, known, "must be held_out or boundary")
        require_positive(self, "evaluate.figure", "duration_s", "horizon_s", "horizon_starts")


@dataclass  # not frozen, for the same reason
class EvaluateConfig:
    """What is measured on the held-out part, from which starts, and for how long.

    Every value is set in ``conf/evaluate/*.yaml``. Durations ending in ``_s`` are seconds, those ending in
    ``_frames`` are frames of the recording, fractions are in [0, 1].

    Source: the published protocol (0.5 s over 50 starts, two periods, free windows).
    """

    seed: int  # of the window starts
    skip_s: float  # start of the held-out part left out of every score
    starts: int  # rollouts per forecast score
    horizon_s: float  # length of the image forecast; the initial state counts as its first state
    periods: float  # length of the latent forecast in natural periods
    velocity: str
    """Initial velocity of a rollout: ``forward`` over the next two frames (as published), ``central`` over
    two frames on each side (less noise), or ``neighbours`` over one on each side, which agrees with an
    integrator of one step a frame even where a period has few frames.
    """
    period_s: float | None  # imposed natural period; null takes the one measured on the free windows
    floor_frames: int  # maximum number of frames the autoencoder floor is averaged over
    divergence_factor: float
    """A rollout has diverged once its state is longer than this many times the longest encoded state."""
    confidence: float  # coverage of the intervals
    free_rate_fraction: float
    """Largest input change per frame of a free segment, as a fraction of the input's range."""
    free_excursion_fraction: float
    """Largest input excursion over a free segment, as a fraction of the input's range."""
    free_min_s: float  # shortest free segment
    free_max_segments: int  # free segments kept, longest first
    window_cycles: float  # length of a spectral window in cycles of its segment's own frequency
    window_min_cycles: float  # lowest bin that may hold the peak, in cycles per window
    window_min_amplitude: float  # windows quieter than this fraction of the clip's RMS are left out
    decay_modes: int  # maximum number of damped oscillations fitted to one window
    figure: FigureConfig

    def __post_init__(self) -> None:
        def require(key: str, holds: bool, rule: str) -> None:
            require_setting(f"evaluate.{key}", getattr(self, key), holds, rule)

        require_positive(self, "evaluate", "starts", "floor_frames", "free_max_segments")
        require_positive(self, "evaluate", "decay_modes", "horizon_s", "periods", "free_min_s")
        require_positive(self, "evaluate", "window_cycles", "window_min_cycles")
        require_least(self, "evaluate", 0, "seed", "skip_s")
        require_least(self, "evaluate", 1, "divergence_factor")
        for key in ("confidence", "free_rate_fraction", "free_excursion_fraction", "window_min_amplitude"):
            require(key, 0.0 < getattr(self, key) < 1.0, "must lie strictly between 0 and 1")
        require("period_s", self.period_s is None or self.period_s > 0, "must be positive or null")
        known = self.velocity in ("forward", "central", "neighbours")
        require("velocity", known, "must be forward, central or neighbours")
        rule = f"must be at least twice window_min_cycles={self.window_min_cycles}: no peak fits the band"
        require("window_cycles", self.window_cycles >= 2 * self.window_min_cycles, rule)


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class GuaranteeConfig:
    """The starts and forces used to test whether a learned law always comes to rest."""

    starts: int  # rollouts from all directions, at rest and moving
    far: float  # their distance, in lengths of the longest encoded state
    force: float
    """Largest constant force: the one whose equilibrium lies at this share of the longest encoded state."""
    duration_s: float  # longest time they may take to settle
    settled: float
    """Distance from the equilibrium that counts as settled, as a share of the longest encoded state."""

    def __post_init__(self) -> None:
        require_positive(self, "extrapolation.guarantee", *vars(self))


@dataclass  # not frozen, for the same reason
class ExtrapolationConfig:
    """How far models are rolled out, where they are compared, and when they leave the chart.

    Every value is set in ``conf/extrapolation/*.yaml``.

    Source: paper, Table "Extrapolation past the training window".
    """

    horizon_s: float  # length of the free rollout past the last training frame
    shown_s: float  # first part of the rollout, measured without gaps
    looks: int
    """Short intervals measured after that, at times that grow by a constant factor up to the horizon."""
    look_periods: float  # length of such an interval, in natural periods
    history_periods: float  # training frames from which a law's state is estimated, in natural periods
    shift_frames: float
    """Each frame is also compared with predictions up to this many frames earlier or later."""
    shift_steps: int  # number of shifts tried, where a model can render between frames
    range_error: float
    """A predicted frame is out of range if its reconstruction error exceeds that of the worst training frame
    by this factor.
    """
    range_distance: float
    """... or if its state lies further from the nearest training state than this share of their rms."""
    least_inside: float  # share of predicted frames in range below which no physics is measured on them
    guarantee: GuaranteeConfig

    def __post_init__(self) -> None:
        def require(key: str, holds: bool, rule: str) -> None:
            require_setting(f"extrapolation.{key}", getattr(self, key), holds, rule)

        require_positive(self, "extrapolation", "horizon_s", "shown_s", "looks", "look_periods")
        require_positive(self, "extrapolation", "history_periods", "range_error", "range_distance")
        require_least(self, "extrapolation", 0, "shift_frames")
        odd = self.shift_steps > 0 and self.shift_steps % 2 == 1
        require("shift_steps", odd, "must be odd, so that no shift is among them")
        require("least_inside", 0 <= self.least_inside <= 1, "is a share: choose it in [0, 1]")
        require("horizon_s", self.horizon_s >= self.shown_s, f"must be at least shown_s={self.shown_s}")
