"""Settings and thresholds of a diagnosis.

`DiagnoseConfig` and `BlindConfig` hold what users set in ``conf/``. The frozen classes after them hold every
other number that can change a verdict: one class a subject, one instance a class, read as
``VERDICT.max_probability``. Each number has its unit in brackets (``[1]`` is a ratio) and its source.

No number here is the result of a fitted calibration yet. "Commit" names the commit of this repository in
which a value was set by hand. Commits before 0de462e precede every sealed split of the benchmark; 0fc4d5b
followed the opening of blind-1, 97c6964 and e6e25e8 that of the four-coordinate and video splits (a61a354),
and 620ccf8 that of blind-6 (95ad2a5): values of these four were chosen with spent splits in view.
"""

from dataclasses import dataclass


@dataclass
class DiagnoseConfig:
    """What a user sets of a diagnosis: ``conf/diagnose/default.yaml`` gives units, ranges and sources."""

    input_hold: str
    """Inputs between samples: ``linear`` or ``zoh`` (zero-order hold)."""
    columns: dict[str, str]
    """Columns of a table that have other names: ``{t: time, q0: angle, u0: torque}``."""
    joints: list[str] | None
    """Joints of a MuJoCo model that are the coordinates; None for all."""
    actuators: list[str] | None
    """Actuators of a MuJoCo model that are the inputs; None for all."""
    without: list[str]
    """Effects that are left out of the catalogue."""
    window_periods: float
    """Length of a simulated window [natural periods]."""
    steps_per_period: float
    """Integration steps in the shortest natural period, at least [count]."""
    identify_iterations: int
    """Iterations that fit a simulator to its own recordings [count]."""
    identify_ridge: float
    """Ridge penalty of the regression that this fit starts from [1]."""
    families: int
    """Effects that are fitted in full after a score test, the best first [count]."""
    places: int
    """Coordinates or inputs at which each of them is fitted [count]."""
    starts: int
    """Starting points of each fit [count]."""
    iterations: int
    """Iterations of each fit [count]."""
    tolerance: float
    """Gain of a step that ends a fit, as a share of the misfit [1]."""
    always_fitted: list[str]
    """Effects that are fitted whatever the score test says."""
    effective_sample_ratio: float
    """Samples of a residual that count as one independent sample, at least [1]."""
    potential: float
    """Prior standard deviation of the simulator's potential, relative [1]."""
    damping: float
    """Prior standard deviation of its damping rate [natural angular frequencies]."""
    inputs: float
    """Prior standard deviation of each input gain, relative [1]."""
    offset: float
    """Prior standard deviation of a constant force [rms of the motion's acceleration]."""
    warp: float
    """Prior standard deviation of a smooth distortion of the coordinates [their range]."""
    learned_factor: float
    """Factor on these five where the simulator was learned from a video [1]."""
    reference_longest_s: float
    """Duration of a simulator's own recordings that is used, at most [s]."""
    materiality: float
    """Share of the gap that an effect must remove to be named [1]."""
    prior_none: float
    """Prior probability that nothing is missing [1]."""
    prior_unknown: float
    """Prior probability that what is missing is not in the catalogue [1]."""
    unknown_midpoint: float
    """Share of the excess misfit left at which `unknown` is as likely as not [1]."""
    sufficient_share: float
    """Share left below which no further effect is needed, and that a set must reach [1]."""
    second_effect_share: float
    """Share of the excess misfit that a second effect must remove [1]."""

    def __post_init__(self) -> None:
        if self.input_hold not in ("linear", "zoh"):
            raise ValueError(
                f"diagnose.input_hold={self.input_hold!r}: choose linear or zoh (held between samples)"
            )
        positive = (
            "reference_longest_s",
            "window_periods",
            "steps_per_period",
            "tolerance",
            "effective_sample_ratio",
            "identify_ridge",
        )
        for name in positive:
            if getattr(self, name) <= 0:
                raise ValueError(f"diagnose.{name}={getattr(self, name)} must be positive")
        for name in ("families", "places", "starts", "iterations", "identify_iterations"):
            if getattr(self, name) < 1:
                raise ValueError(f"diagnose.{name}={getattr(self, name)} must be at least 1")
        shares = (
            *("potential", "damping", "inputs", "offset", "warp", "materiality", "prior_none"),
            *("prior_unknown", "unknown_midpoint", "second_effect_share", "sufficient_share"),
        )
        for name in shares:
            if not 0 < getattr(self, name) < 1:
                raise ValueError(f"diagnose.{name}={getattr(self, name)} must lie between 0 and 1")
        if self.prior_none + self.prior_unknown >= 1:
            raise ValueError("diagnose.prior_none and prior_unknown leave no probability for the effects")


@dataclass
class BlindConfig:
    """A sealed split of the benchmark, and who predicts it."""

    split: str
    """Name of the split. A revealed one is spent; another name draws another split."""
    keys: str
    """Folder of the secret keys, one a split, outside of everything that a prediction may read."""
    systems: str
    """Group of mechanisms that the generator draws from."""
    t0: int
    """Recordings that are trajectories [count]; 0 leaves this tier out."""
    t1: int
    """Recordings that are videos [count]; 0 leaves this tier out."""
    film_steps: int
    """Steps of stage 1 on each nominal video [count]."""
    film_gaussians: int
    """Gaussians that render it [count]."""
    batch: int
    """Recordings in a job [count]."""
    left_out: int
    """Recordings, at most, that are diagnosed again without their effect in the catalogue [count]."""
    baselines: list[str]
    """Other methods in the table."""
    reveal: bool
    """Write the outcome of every recording, after which the split is spent."""

    def __post_init__(self) -> None:
        for name in ("t0", "t1", "left_out"):
            if getattr(self, name) < 0:
                raise ValueError(f"blind.{name}={getattr(self, name)} counts recordings; give 0 or more")
        if self.t0 + self.t1 == 0:
            raise ValueError("blind.t0=0 and blind.t1=0 leave no recording; give one of them a number")
        for name in ("batch", "film_steps", "film_gaussians"):
            if getattr(self, name) < 1:
                raise ValueError(f"blind.{name}={getattr(self, name)} must be at least 1")
        if not self.split.replace("-", "").isalnum():
            raise ValueError(f"blind.split={self.split!r} names a folder; take letters, digits and hyphens")


@dataclass(frozen=True)
class EstimationProblemSettings:
    """Which windows and directions enter an estimation."""

    max_squared_deviation: float = 40.0
    """Squared deviation of the nuisance parameters, in prior variances times the noise inflation, that costs
    nothing extra [1]. Commit a1527c2."""
    min_known_share: float = 0.7
    """Share of windows the simulator must know before the others are left out [1]. Commit 937389d."""
    max_open_directions: int = 6
    """Directions that the identification of the simulator leaves open, at most [count]. Commit 0e95f8e."""


PROBLEM = EstimationProblemSettings()


@dataclass(frozen=True)
class SelectionSettings:
    """Search over effects and their fits."""

    refined_fits: int = 3
    """Best fits that are refined to convergence [count]. Commit c12aa78."""
    refined_iterations: int = 5
    """Iterations of a refined fit, over those of the first fit [1]. Commit c12aa78."""
    refined_tolerance: float = 0.03
    """Tolerance of a refined fit, over that of the first fit [1]. Commit c12aa78."""
    max_noise_correlation: float = 0.5
    """Correlation of neighboring residuals [1] from which an effect on single samples explains nothing.
    Commit 8279c95."""
    visible_repeat_misfit: float = 4.0
    """Mean square by which repeated samples must miss the motion to be visible [noise variances]. Commit
    97b9096."""
    start_shares: tuple[float, ...] = (1.0, 0.5, 0.25, 0.1, 0.03)
    """Shares of the amplitude from the score test that are tried as starts [1]. Commit 123f88b."""


SELECTION = SelectionSettings()


@dataclass(frozen=True)
class CombinationSettings:
    """Sets of several effects."""

    max_effects: int = 3
    """Effects in a set, at most [count]. Commit 0e95f8e."""
    max_first_effects: int = 3
    """Single effects beside which a second one is sought [count]. Commit 0e95f8e."""
    min_excess: float = 0.1
    """Excess mean square residual from which a further effect is sought [noise variances]. Commit 123f88b."""


COMBINATIONS = CombinationSettings()


@dataclass(frozen=True)
class VerdictSettings:
    """From log evidence to probabilities."""

    max_log_evidence: float = 200.0
    """Log evidence that counts in all [nat]; more is an error of the laws, see `evidence_temperature`.
    Commit 6891504."""
    elastic_creep_share: float = 0.5
    """Time constant of creep, as a share of the recording [1], from which it acts as a spring. Commit
    88ac3e6."""
    elastic_creep_penalty: float = 4.0
    """Log prior of such creep, lowered by [nat]. Commit 88ac3e6."""
    equivalent_log_evidence: float = 3.0
    """Difference of log evidence within which two effects are equivalent [nat]; twice that within one class.
    Commit 0e95f8e."""
    max_probability: float = 0.98
    """Probability that no name exceeds [1]. Commit 8360ea4."""
    law_error: float = 0.03
    """Mean square residual that a right law may leave by its own errors, as a share of the nominal one [1].
    Commit 0fc4d5b."""
    min_unknown: float = 0.015
    """Probability of `unknown`, at least [1]. Commit 8360ea4."""
    unknown_exponent: float = 2.5
    """Exponent of the unexplained share in the odds of `unknown` [1]. Commit df5bf1f."""
    deviation_factor: float = 1.5
    """Factor on a parameter's standard deviation [1], because laws are approximate. Commit 6891504."""
    deviation_floor: float = 0.01
    """Added to that standard deviation [prior standard deviations]. Commit 6891504."""
    set_lead: float = 5.0
    """Log posterior of a set's members above any single effect, where the set explains everything [nat].
    Commit df5bf1f."""


VERDICT = VerdictSettings()


@dataclass(frozen=True)
class ImplausibilitySettings:
    """Reasons against an explanation that leaves nothing unexplained."""

    unrepeated_chance: float = 0.7
    """P(unknown) where no state recurs without the external force [1]. Commit 0fc4d5b."""
    flexible_chance: float = 0.6
    """P(unknown) where two flexible effects are needed [1]. Commit 0fc4d5b."""
    relaxed_lead: float = 0.0
    """Log evidence by which the relaxed simulator leads at even odds [nat]. Commit 3570551."""
    relaxed_scatter: float = 2.0
    """Width of the logistic in that lead [nat]. Commit 3570551."""
    state_distance: float = 0.3
    """Distance of two equal states [rms of position and velocity]. Commit dd24cef."""
    passage_periods: float = 0.25
    """Time between a push and a separate passage of the same state [natural periods]. Commit 0fc4d5b."""
    certain_cycles: float = 4.0
    """Cycles from which a force is surely periodic [count]. Commit 0fc4d5b."""
    min_push_share: float = 0.1
    """Strength of a push over the strongest [1] below which it is none. Commit 0fc4d5b."""
    relaxation: float = 60.0
    """Factor on the prior standard deviations of the relaxed simulator [1]: parts in a thousand become tens
    of per cent. Commit 0fc4d5b."""
    max_nominal_misfit: float = 1.5
    """Mean square residual on its own recordings up to which a relaxed simulator is credible [noise
    variances]. Commit 97c6964."""
    relaxed_misfit_margin: float = 0.05
    """Mean square by which the relaxed simulator may be worse [noise variances]. Commit 0fc4d5b."""


IMPLAUSIBILITY = ImplausibilitySettings()


@dataclass(frozen=True)
class PlacementSettings:
    """Where effects are tried."""

    max_joint_coordinates: int = 3
    """Coordinates up to which effects are tried between each two [count]. Commit 71ce7a9."""
    free_memory_clips: int = 3
    """Clips, the longest, whose memory starts free [count]. Commit c12aa78."""
    max_lines: int = 5
    """Spectral lines tried as a periodic force [count]. Commit 66f7fa5."""
    max_line_frequency: float = 0.2
    """Highest line, over the frame rate [1]. Commit efdf4b2."""


PLACEMENT = PlacementSettings()


@dataclass(frozen=True)
class ProfileSettings:
    """Profile likelihoods of fitted parameters."""

    points_per_side: int = 4
    """Points on each side of the best value [count]. Commit c57c528."""
    reach_deviations: float = 3.5
    """Reach on each side [standard deviations]. Commit c57c528."""
    iterations: int = 4
    """Iterations of each fit [count]. Commit c57c528."""
    max_parameters: int = 4
    """Parameters that are profiled, at most [count]. Commit c57c528."""
    pin_deviation: float = 1e-4
    """Prior standard deviation that pins the parameter [its standard deviations]. Commit c57c528."""


PROFILES = ProfileSettings()


@dataclass(frozen=True)
class IdentifiabilitySettings:
    """Which effects a recording could separate."""

    max_effects: int = 8
    """Effects that are compared, at most [count]. Commit c57c528."""


IDENTIFIABILITY = IdentifiabilitySettings()


@dataclass(frozen=True)
class HoldoutSettings:
    """Held-out forecasts."""

    start_samples: int = 10
    """Samples that the initial state is fitted to [count]; repeated samples do not count. Commit 0e95f8e."""
    min_period_share: float = 0.25
    """Length of a block, at least [natural periods], where the simulator cannot be followed longer. Commit
    0fc4d5b."""
    min_block_samples: int = 20
    """Samples of the shortest block [count]. Commit 0e95f8e."""
    diverged_error: float = 10.0
    """Error from which a forecast has diverged [rms of the coordinate]. Commit 6c6edb9."""


HOLDOUT = HoldoutSettings()


@dataclass(frozen=True)
class RecalibrationSettings:
    """Calibration of a given simulator on recordings without an effect."""

    null_evidence_factor: float = 4.0
    """Log evidence that the same errors may reach in another recording, over that in the reference recording
    [1]. Commit 97c6964."""
    degree_steps: tuple[tuple[int, ...], ...] = ((0, 1, 4, 1), (0, 2, 4, 2))
    """Highest degrees of mass, damping, potential and input map that move, step by step [1]. Commit
    937389d."""
    degree_steps_many: tuple[tuple[int, ...], ...] = ((0, 0, 3, 0),)
    """The same where there are many coordinates [1]. Commit 937389d."""
    iterations_factor: int = 2
    """Iterations, over those of an identification [1]; a fitted law is stiffer. Commit 937389d."""
    move_deviation: float = 0.3
    """Prior standard deviation of a move, in units of the acceleration that it changes [1]. Commit
    937389d."""
    max_remaining_misfit: float = 0.9
    """Misfit on windows that were not fitted, over that before [1]. Commit 937389d."""
    direction_samples: int = 400
    """Samples on which moves are compared [count]. Commit 937389d."""
    direction_step: float = 1e-6
    """Finite-difference step of a move [1]. Commit 937389d."""
    direction_cutoff: float = 1e-8
    """Eigenvalue, over the largest one [1], below which a move changes nothing. Commit 937389d."""


RECALIBRATION = RecalibrationSettings()


@dataclass(frozen=True)
class RobustnessSettings:
    """Noise inflation, and repeats of the verdict under perturbations."""

    inflation_misfit: float = 4.0
    """Mean square residual, over the nominal one [1], from which the noise is inflated. Commit 97c6964."""
    min_agreeing: int = 4
    """Repeats of the five that must agree with the verdict [count]. Commit e6e25e8."""
    refitted_effects: int = 3
    """Effects that are fitted again beside those of the verdict [count]. Commit e6e25e8."""
    iterations: int = 4
    """Iterations of each repeated fit [count]. Commit e6e25e8."""
    noise_seeds: tuple[int, ...] = (101, 102)
    """Seeds of the added noise. Commit e6e25e8."""
    frozen_warp_share: float = 1e-6
    """Share of the coordinates' prior warp that is left where none is allowed [1]. Commit e6e25e8."""


ROBUSTNESS = RobustnessSettings()


@dataclass(frozen=True)
class MaterialitySettings:
    """When an effect is too small to be named.

    Source: set by hand when the module was written (commit 0e95f8e), before any fitted calibration.
    """

    certain_log_evidence: float = 30.0
    """Log evidence from which an effect is named even if the forecasts hardly improve [nat]. Commit
    0e95f8e."""
    close_floor_ratio: float = 1.5
    """Forecast error over the noise floor [1] up to which no cause is needed. Commit 97c6964."""
    overestimated_noise_misfit: float = 0.5
    """Mean square residual [noise variances] below which the noise was overestimated and no effect is
    needed. Commit 620ccf8."""
    max_closures: int = 4
    """Candidates whose own closure is computed [count]. Commit 0e95f8e."""


MATERIALITY = MaterialitySettings()
