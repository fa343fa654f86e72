"""Settings and thresholds of a diagnosis.

`DiagnoseConfig` and `BlindConfig` hold what users set in ``conf/``. The frozen classes after them hold every
other number that can change a verdict: one class a subject, one instance a class, read as
``VERDICT.max_probability``. Each number has its unit in brackets (``[1]`` is a ratio) and its source.

No number here is the result of a fitted calibration yet. "Commit" names the commit of this repository in
which a value was set by hand: beside the value, or beside its class for all of them. Commits before 0de462e
precede every sealed split of the benchmark. Later ones followed the opening of one split or more (22a8644
opened blind-1, 5353e65 blind-2, a61a354 two small splits, 95ad2a5 blind-6), so that their values may have
been chosen with a spent split in view.
"""

from dataclasses import dataclass


@dataclass
class DiagnoseConfig:
    """What a user sets of a diagnosis: ``conf/diagnose/default.yaml`` gives units, ranges and sources."""

    input_hold: str  # inputs between samples: `linear` or `zoh` (zero-order hold)
    columns: dict[str, str]  # columns of a table that have other names: `{t: time, q0: angle, u0: torque}`
    joints: list[str] | None  # joints of a MuJoCo model that are the coordinates; None for all
    actuators: list[str] | None  # actuators of a MuJoCo model that are the inputs; None for all
    without: list[str]  # effects that are left out of the catalogue
    window_periods: float  # length of a simulated window [natural periods]
    steps_per_period: float  # integration steps in the shortest natural period, at least [count]
    identify_iterations: int  # iterations that fit a simulator to its own recordings [count]
    identify_ridge: float  # ridge penalty of the regression that this fit starts from [1]
    families: int  # effects that are fitted in full after a score test, the best first [count]
    places: int  # coordinates or inputs at which each of them is fitted [count]
    starts: int  # starting points of each fit [count]
    iterations: int  # iterations of each fit [count]
    tolerance: float  # gain of a step that ends a fit, as a share of the misfit [1]
    always_fitted: list[str]  # effects that are fitted whatever the score test says
    effective_sample_ratio: float  # samples of a residual that count as one independent sample, at least [1]
    potential: float  # prior standard deviation of the simulator's potential, relative [1]
    damping: float  # prior standard deviation of its damping rate [natural angular frequencies]
    inputs: float  # prior standard deviation of each input gain, relative [1]
    offset: float  # prior standard deviation of a constant force [rms of the motion's acceleration]
    warp: float  # prior standard deviation of a smooth distortion of the coordinates [their range]
    learned_factor: float  # factor on these five where the simulator was learned from a video [1]
    reference_longest_s: float  # duration of a simulator's own recordings that is used, at most [s]
    materiality: float  # share of the gap that an effect must remove to be named [1]
    prior_none: float  # prior probability that nothing is missing [1]
    prior_unknown: float  # prior probability that what is missing is not in the catalogue [1]
    unknown_midpoint: float  # share of the excess misfit left at which `unknown` is as likely as not [1]
    sufficient_share: float
    """Share left below which no further effect is needed, and that a set must reach [1]."""
    second_effect_share: float  # share of the excess misfit that a second effect must remove [1]

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

    split: str  # name of the split. A revealed one is spent; another name draws another split.
    keys: str  # folder of the secret keys, one a split, outside of everything that a prediction may read
    systems: str  # group of mechanisms that the generator draws from
    t0: int  # recordings that are trajectories [count]; 0 leaves this tier out
    t1: int  # recordings that are videos [count]; 0 leaves this tier out
    film_steps: int  # steps of stage 1 on each nominal video [count]
    film_gaussians: int  # Gaussians that render it [count]
    batch: int  # recordings in a job [count]
    left_out: int
    """Recordings, at most, that are diagnosed again without their effect in the catalogue [count]."""
    baselines: list[str]  # other methods in the table
    reveal: bool  # write the outcome of every recording, after which the split is spent

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


# --- Data quality


@dataclass(frozen=True)
class TrajectoryCheckThresholds:
    """Checks of both trajectories against each other. Commit d06fac6."""

    period_ratio_warning: float = 2.0
    """Ratio of the two sides' periods, either way [1], from which the period of a driven motion is not
    trusted."""


TRAJECTORY_CHECKS = TrajectoryCheckThresholds()


@dataclass(frozen=True)
class ClosedLoopThresholds:
    """Tests for inputs that a controller computes from the measured motion. Commit d06fac6."""

    difference_order: int = 6
    """Order of the differences that keep the measurement errors and remove the smooth motion [count]."""
    min_power_growth: float = 1.2
    """Growth of the power from one more difference [1]; white noise gives 3.7, a smooth signal less than
    1."""
    step_ratio: float = 8.0  # change between two samples, in usual changes [1], from which an input steps
    max_controller_lag: int = 4  # samples that a controller may take to respond [count]
    min_explained_share: float = 0.1  # share of an input's own error that the errors of q must explain [1]
    max_p_value: float = 1e-6
    """Probability that chance alone explains as much [1]: a false-alarm rate of one in a million tests."""
    min_static_share: float = 0.95
    """Share of an input that a static function of q and v must explain where there is no noise [1]."""
    max_relative_acceleration: float = 0.5
    """Acceleration over the restoring one [1] below which a slow motion follows any input."""
    single_line_share: float = 0.9
    """Share of an input's power in one spectral line [1] from which q and v follow it whatever the cause."""


CLOSED_LOOP = ClosedLoopThresholds()


@dataclass(frozen=True)
class CompatibilityThresholds:
    """Whether the real motion lies where the simulator was seen, and in the same units. Commit d06fac6."""

    region_factor: float = 1.5  # size of the simulator's region, in its 99 % quantile of the distance [1]
    warning_outside_share: float = 0.05
    """Share of real samples outside the region that is worth a warning [1]."""
    undetermined_outside_share: float = 0.5
    """Share of real samples outside the region that forbids a verdict [1]."""
    max_center_offset: float = 6.0
    """Distance of the two motions' middles, in the simulator's standard deviations [1]."""
    unit_ratio_tolerance: float = 0.35
    """Relative error within which a ratio of sizes counts as a known ratio of units [1]."""
    striking_size_ratio: float = 20.0  # ratio of sizes that asks for an explanation [1]


COMPATIBILITY = CompatibilityThresholds()


@dataclass(frozen=True)
class DiscontinuityThresholds:
    """Where a trajectory is not continued: cuts, gaps and holds before a release. Commit d06fac6 and
    71ca292."""

    polynomial_samples: int = 8  # samples of the polynomial on either side of a border, at most [count]
    polynomial_periods: float = 0.15  # duration of that polynomial, at most [natural periods]
    jump_standard_errors: float = 8.0  # jump, in standard errors [1], from which it is significant
    knock_ratio: float = 2.0  # jump over what a knock between two samples could displace [1]
    mismatch_ratio: float = 3.0
    """Jump over the usual mismatch around it [1]; the usual mismatch comes from the curvature of the
    motion."""
    mismatch_quantile: float = 0.9  # quantile of the mismatches around a jump that counts as usual [1]
    neighborhood_lengths: int = 6  # polynomial lengths to either side that count as around [1]
    isolated_step_share: float = 0.5
    """Share of the jump by which the step must exceed its neighbors [1]; a swing takes several samples."""
    min_range_share: float = 0.03  # jump over the range of the motion around it [1]
    rate_mismatch_ratio: float = 0.4  # difference of the rates on both sides, in typical speeds [1]
    max_cuts_per_period: float = 0.5  # cuts in one natural period above which they are no cuts [count]
    max_lost_frames: float = 10.5  # frames that a camera loses at once, at most [count]
    min_gap_steps: float = 3.0  # length of a gap, in sampling steps [1]
    min_gap_periods: float = 0.125  # length of a gap, in natural periods [1]; a gap exceeds both
    min_hold_periods: float = 0.4  # duration of a hold [natural periods]
    min_hold_offset: float = 0.7
    """Distance of a hold from the middle of the swing after it, in its amplitudes [1]."""
    max_hold_motion: float = 0.2  # motion during a hold, in amplitudes of the swing after it [1]
    min_swing_noise_ratio: float = 12.0  # amplitude of that swing over the noise [1]


DISCONTINUITIES = DiscontinuityThresholds()


@dataclass(frozen=True)
class RepeatedFrameThresholds:
    """Samples that repeat an earlier one, as from a camera that lost frames. Commit d06fac6 and 71ca292."""

    same_image_steps: float = 3.0  # step, in those that noise makes, up to which an image is the same [1]
    jump_steps: float = 6.0  # step, in those that noise makes, from which the image has jumped [1]
    max_repeats: int = 200  # samples in a row that an image may stay the same [count]
    curvature_lag: int = 3  # samples over which the curvature of the motion is measured [count]
    curvature_quantile: float = 0.95  # quantile of the curvature that counts as usual [1]
    neighbor_samples: int = 5  # samples on either side of a repeat through which a polynomial is laid [count]
    polynomial_degree: int = 3  # degree of that polynomial [1]
    significant_miss: float = 5.0
    """Distance of a repeat from the polynomial, in noise steps [1], from which it is a repeat."""
    curvature_margin: float = 1.3  # curvature during the repeat over the usual one [1]
    neighbor_misfit_share: float = 0.1
    """Share of that distance by which the neighbors may miss the polynomial [1]."""
    min_certain_repeats: int = 5  # certain repeats from which shorter ones count too [count]
    min_uncertain_length: int = 4  # samples of such a shorter repeat [count]


REPEATED_FRAMES = RepeatedFrameThresholds()


@dataclass(frozen=True)
class ExcitationThresholds:
    """What counts as motion, rest and a level when excitation is measured. Commit d06fac6."""

    swing_noise_ratio: float = 5.0  # swing over the noise's standard deviation [1] from which it is one
    slow_rate_share: float = 0.1  # rate, as a share of its rms [1], below which the motion is slow
    rest_rate_share: float = 0.03
    """Rate, as a share of its rms [1], below which the motion rests; the noise of the rate if that is
    larger."""
    min_rest_periods: float = 0.5  # duration of a rest [natural periods]
    level_separation: float = 0.1  # distance of two holds or input levels, as a share of the range [1]
    constant_tolerance: float = 1e-6
    """Variation of a constant input, as a share of its size [1]: rounding of printed numbers."""


EXCITATION = ExcitationThresholds()


@dataclass(frozen=True)
class NaturalPeriodThresholds:
    """Weak-form regression of a linear law for the natural period. Commit d06fac6."""

    lengths_per_decade: int = 14  # lengths of test functions tried in a decade [count]
    min_test_samples: int = 9  # samples of the shortest test function [count]
    max_samples: int = 6000  # samples of all clips together; longer ones are decimated [count]
    min_explained_share: float = 0.3
    """Share of the weighted accelerations that the linear law must explain [1]."""
    min_surplus: float = 2.0
    """Independent test functions beyond the unknowns [count]; with fewer, any law fits."""
    max_stiffness_error: float = 0.15  # relative standard error of a stiffness [1] from which it is dropped
    turn_size: float = 0.1  # return of the motion, in its standard deviations [1], that counts as a turn
    min_mode_share: float = 0.08  # share of the motion that the slowest mode must carry [1]
    min_spectrum_samples: int = 16  # samples of the shortest clip whose spectrum is taken [count]
    step_period_ratio: float = 1.6
    """Period of the coordinates over that of their rates [1] from which the motion steps."""


NATURAL_PERIOD = NaturalPeriodThresholds()


@dataclass(frozen=True)
class NoiseEstimationSettings:
    """Moving-window polynomial fit that separates noise from motion. Commit d06fac6."""

    polynomial_degree: int = 5  # degree of the polynomial in a window [1]
    min_window: int = 9  # samples of the shortest window [count]
    max_window: int = 24  # samples of the longest window [count]
    max_window_periods: float = 0.25  # duration of a window, at most [natural periods]
    max_windows: int = 600  # windows looked at, evenly over the motions [count]
    student_t_freedom: float = 4.0
    """Degrees of freedom of Student's t [1]; heavy tails, because kinks of the motion fall into some
    windows."""
    correlation_grid: tuple[float, float, int] = (-0.6, 0.9, 16)
    """First and last correlation of neighboring errors that is tried, and how many [1, 1, count]."""
    window_agreement: float = 1.25
    """Noise of a longer window over that of the shortest [1], beyond which it holds motion."""
    correlated_log_ratio: float = 6.0
    """Log-likelihood ratio by which correlated noise must beat white noise [nat]."""


NOISE_ESTIMATION = NoiseEstimationSettings()


@dataclass(frozen=True)
class SamplingThresholds:
    """How densely, evenly and finely a motion is sampled. Commit d06fac6."""

    decimated_samples_per_period: float = 100.0
    """Samples in the rms period of the rates that decimation keeps [count]."""
    decimated_rate_hz: float = 120.0
    """Rate that decimation keeps [Hz]; lost and late frames are looked for at camera rates."""
    repeat_noise_ratio: float = 4.0
    """Step, in standard deviations of noise [1], that the motion must make before an equal value is a
    repeat."""
    coarse_samples_per_period: float = 8.0  # samples in a period below which a warning is due [count]
    min_samples_per_period: float = 4.0  # samples in a period below which nothing is computed [count]
    quantization_share: float = 0.1
    """Quantization step over the rms of the coordinate [1] that is worth a note."""
    clipped_share: float = 0.02  # share of samples at an extreme [1] from which a sensor saturates
    clipped_run: int = 4  # samples in a row at that extreme [count]
    max_repeats: int = 10  # repeats in a row that are a lost frame [count]; more are a rest
    rest_noise_ratio: float = 3.0  # motion over the noise [1] below which nothing moves
    block_periods: float = 1.5  # duration of a block whose sampling is judged [natural periods]
    block_samples: int = 60  # samples of such a block, at least [count]
    min_blocks: int = 8  # blocks from which a comparison is made [count]
    min_periods: float = 2.5  # duration of a recording [natural periods] below which too little repeats


SAMPLING = SamplingThresholds()


@dataclass(frozen=True)
class TimeAlignmentThresholds:
    """Whether inputs and coordinates share a clock. Commit d06fac6."""

    max_shift_periods: float = 3.0  # shift of the inputs, at most [natural periods]
    shifts_per_period: int = 16  # shifts tried in one natural period [count]
    gross_shift_periods: float = 0.5
    """Shift [natural periods] that no delay of a mechanism or a line explains."""
    poor_explained_share: float = 0.6  # share explained [1] below which the given times are questioned
    min_share_gain: float = 0.35  # gain of the explained share [1] that decides for a shift
    min_periods: float = 6.0  # duration of a recording [natural periods] below which chance fits some shift
    fair_explained_share: float = 0.85
    """Share explained [1] below which the times are questioned if `min_error_ratio` is reached as well."""
    min_error_ratio: float = 4.0  # ratio by which a shift must shrink what is not explained [1]


TIME_ALIGNMENT = TimeAlignmentThresholds()


# --- Residual


@dataclass(frozen=True)
class ChangePointSettings:
    """Events: stretches in which the residual is larger than around them. Commit 09186ef."""

    stride_periods: float = 0.125  # distance of the levels among which changes are sought [natural periods]
    window_periods: float = 0.5  # moving window [natural periods] over which the square of a swing is level
    log_level_variance: float = 0.5  # variance of a level's logarithm where nothing changes [1]
    merge_log_ratio: float = 2.0  # difference of two neighbors' log levels [1] below which they are one event
    edge_share: float = 0.25  # share of its peak [1] at which an event begins and ends
    min_energy_share: float = 0.02  # share of the residual's energy below which an event is not reported [1]
    false_discovery_rate: float = 0.05  # rate of false discoveries [1]
    max_events: int = 5  # events that are reported, at most [count]


CHANGE_POINTS = ChangePointSettings()


@dataclass(frozen=True)
class ComponentSettings:
    """Kernel regression of the residual on groups of features. Commit 09186ef."""

    ridges: tuple[float, ...] = (1e-5, 1e-3, 1e-1)  # ridge penalties tried by cross-validation [1]
    width_factors: tuple[float, ...] = (1.0, 3.0)
    """Kernel widths tried, over the root of the number of features [1]."""
    max_samples: int = 400  # samples of the regression, at most [count]
    correlation_z: float = 1.96
    """Standard deviations of a correlation that chance exceeds with probability 0.05 [1]: the normal quantile
    of 0.975."""


COMPONENTS = ComponentSettings()


@dataclass(frozen=True)
class ErrorBudgetSettings:
    """Shares of the forecast error by stage, and whether images can be trusted. Commit 6e0f2c7."""

    bootstrap_draws: int = 999  # draws of the block bootstrap [count]
    coverage: float = 0.95  # coverage of its intervals [1]
    suspect_error_ratio: float = 2.0
    """Error of the real images over that of the nominal ones [1] from which perception is suspect."""
    suspect_outside_share: float = 0.05
    """Share of frames outside the nominal latents [1] from which perception is suspect."""
    outside_quantile: float = 0.999  # quantile of the nominal distances beyond which a frame is outside [1]
    max_relative_error: float = 1e3  # error that a diverged forecast counts with [rms of the coordinate]
    max_step_share: float = 0.02  # step of the forecast's integrator, as a share of the horizon, at most [1]


ERROR_BUDGET = ErrorBudgetSettings()


@dataclass(frozen=True)
class ResidualFeatureSettings:
    """Features that the residual is regressed on. Commit 09186ef."""

    lags_periods: tuple[float, ...] = (0.125, 0.25, 0.5, 1.0)  # lags of memory features [natural periods]
    reversal_rate_share: float = 0.05  # rate, as a share of its rms [1], below which the motion reverses
    block_periods: float = 0.75  # length of a block of the cross-validation [natural periods]
    folds: int = 5  # folds of the cross-validation [count]
    max_samples: int = 800  # samples of the regression, at most [count]


RESIDUAL_FEATURES = ResidualFeatureSettings()


@dataclass(frozen=True)
class LatentForceSettings:
    """Smoother of the force that the simulator lacks. Commit 6c919a8."""

    length_scales_periods: tuple[float, ...] = (0.125, 0.5, 2.0)  # length scales tried [natural periods]
    path_tolerance: float = 1e-3  # change of the path, over its rms [1], that ends the iteration
    max_iterations: int = 5  # relinearizations, at most [count]
    start_force_share: float = 0.01
    """Variance of the force where its fit starts, over that of the acceleration [1]."""
    min_log_likelihood_gain: float = 3.0
    """Gain from which a force is admitted [nat]; without a force, 1 record in 100 gains more by chance."""


LATENT_FORCE = LatentForceSettings()


@dataclass(frozen=True)
class LinearizationSettings:
    """Transition matrices along a path. Commit 6c919a8."""

    max_step_rad: float = 0.5  # Runge-Kutta step, at most [rad of the fastest mode]


LINEARIZATION = LinearizationSettings()


@dataclass(frozen=True)
class LocalizationThresholds:
    """Level at which the gap arises: perception, chart, actuation or dynamics. Commit 09186ef."""

    min_actuation_share: float = 0.4
    """Share of all that is explained that functions of the inputs must explain [1]."""
    min_actuation_residual_share: float = 0.1  # share of the residual that they must explain [1]
    min_chart_share: float = 0.5  # share that distorted coordinates must explain [1]
    min_chart_lead: float = 0.1  # lead of that share over any kind of force [1]
    min_speed_noise_share: float = 0.3  # share of the noise that must grow with speed [1]
    max_speed_noise_p: float = 0.01  # probability of that growth by chance [1]
    max_event_time_share: float = 0.2  # share of the time that brief events fill, at most [1]
    min_event_energy_share: float = 0.7  # share of the residual's energy that brief events hold, at least [1]


LOCALIZATION = LocalizationThresholds()


@dataclass(frozen=True)
class MeasurementModelSettings:
    """Tests of the measurement against the force. Commit 09186ef."""

    sign_flips: int = 999  # random sign flips of the permutation test [count]


MEASUREMENT_MODEL = MeasurementModelSettings()


@dataclass(frozen=True)
class SpectrumSettings:
    """Multitaper spectrum of the residual (Thomson 1982, doi:10.1109/PROC.1982.12433). Commit 09186ef."""

    half_bandwidth: float = 3.0  # time-bandwidth product of the tapers [1]
    tapers: int = 5  # number of tapers [count]: twice the product less one
    padding: int = 6
    """Zero padding of the transform [1], so that a line between two frequencies is not taken for noise."""
    min_clip_periods: float = 3.0  # duration of a clip that has a spectrum [natural periods]
    max_frequency_ratio: float = 12.0  # highest frequency, in natural frequencies [1]
    line_false_alarm_rate: float = 0.01  # probability of a false line [1]
    band_edge_share: float = 0.1  # share of its peak [1] at which a band begins and ends
    min_band_share: float = 0.05  # share of the power below which a band is not reported [1]
    min_relative_power: float = 1e-3  # power over the largest one [1] below which coherence means nothing
    max_bands: int = 5  # bands that are reported, at most [count]


SPECTRUM = SpectrumSettings()


@dataclass(frozen=True)
class StateMapSettings:
    """Cluster permutation test on maps over position and velocity. Commit 09186ef."""

    map_bins: int = 8  # bins of a map in each direction [count]
    profile_bins: int = 12  # bins of a profile [count]
    sign_flips: int = 999  # random sign flips of the permutation test [count]
    significance: float = 0.05  # level of that test [1]
    cluster_standard_errors: float = 2.0  # standard errors at which a bin joins a cluster [1]
    min_blocks: int = 6
    """Blocks of a test [count]: 2^6 sign patterns are the fewest that can reach a level of 0.05."""


STATE_MAPS = StateMapSettings()


# --- Estimation


@dataclass(frozen=True)
class DatasetSettings:
    """How recordings become the data of an estimation. Commit 66f7fa5."""

    min_relative_noise: float = 1e-3  # assumed noise, at least, over the rms of the coordinate [1]
    noise_window_periods: float = 0.15
    """Width of the local cubic whose residual is the noise [natural periods]: about a seventh of a period."""
    region_margin: float = 0.15  # margin around the visited region, as a share of half its range [1]


DATASET = DatasetSettings()


@dataclass(frozen=True)
class ShootingSettings:
    """Gauss-Newton iterations of multiple shooting (Bock 1983). Commit 66f7fa5."""

    max_stale_steps: int = 4  # steps after which all derivatives are computed anew [count]
    max_attempts: int = 6  # damping factors tried for one step before the fit ends [count]


SHOOTING = ShootingSettings()


# --- Identification


@dataclass(frozen=True)
class EstimatedSimulatorSettings:
    """Windows on which a simulator is fitted to its own recordings. Commit 0e95f8e."""

    diverged_misfit: float = 50.0
    """Mean square residual beyond which a window is too long to follow [noise variances]."""
    fit_tolerance: float = 1e-4  # gain of a step that ends the fit, as a share of the misfit [1]
    window_scales: tuple[float, float] = (0.35, 0.12)
    """Lengths of shorter windows, as shares of the usual one [1], for motion about an unstable rest."""
    min_window_frames: int = 12  # frames of a window, at least [count]


ESTIMATED_SIMULATOR = EstimatedSimulatorSettings()


@dataclass(frozen=True)
class NoveltyThresholds:
    """Windows that a simulator was never seen in, and outlier windows of its own recordings. Commit
    937389d."""

    distance_quantile: float = 0.999
    """Quantile of the distance between reference windows beyond which a window is new [1]."""
    poor_misfit: float = 4.0
    """Mean square residual above which outlier windows are looked for [noise variances]."""
    good_misfit: float = 1.5
    """Mean square residual below which the remaining windows are explained [noise variances]."""
    outlier_ratio: float = 4.0  # mean square of an outlier window over the median [1]
    max_remaining_share: float = 0.25  # share of the mean square that the other windows may leave [1]
    max_outliers: int = 3  # outlier windows, at most [count]
    min_windows_per_outlier: int = 4  # windows for each outlier, at least [count]
    min_windows: int = 8
    """Windows from which outliers are looked for [count]; the median of fewer is unreliable."""


NOVELTY = NoveltyThresholds()


@dataclass(frozen=True)
class StructureSearchSettings:
    """Growth of the polynomial law of an estimated simulator. Commit 66f7fa5."""

    max_inertia_coupling: float = 0.3
    """Prior standard deviation of the inertia between two coordinates, over their own [1]."""
    min_misfit_reduction: float = 0.2
    """Share of the misfit that a larger structure must remove where each costs minutes [1]."""
    coefficient_deviation: float = 3.0
    """Prior standard deviation of a coefficient about its first estimate, in units of its field [1]."""
    equivalent_misfit_ratio: float = 1.02
    """Misfit, over the least one [1], up to which a simpler law is as good."""
    test_width_factors: tuple[float, ...] = (1.0, 0.5, 0.25)
    """Lengths of test functions, over the usual one [1]."""


STRUCTURE_SEARCH = StructureSearchSettings()


# --- Given simulators


@dataclass(frozen=True)
class ProjectionThresholds:
    """Projection of a given simulator on polynomial fields. Commit 3c11127."""

    warning_error: float = 0.02  # relative error of the acceleration above which a warning is due [1]


PROJECTION = ProjectionThresholds()


@dataclass(frozen=True)
class ProjectionFieldSettings:
    """Fields of that projection. Commit 692b79f."""

    tolerance: float = 0.003  # relative error of the acceleration below which no field is added [1]
    default_friction_width: float = 0.02
    """Width of smooth dry friction unless another fits better [rms of the speed]."""
    friction_widths: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2)  # widths tried [rms of the speed]


PROJECTION_FIELDS = ProjectionFieldSettings()


# --- Images and videos


@dataclass(frozen=True)
class ImageLocalizationThresholds:
    """Where in the image a force acts, and where the image is wrong. Commit 6e0f2c7."""

    min_contrast: float = 0.05
    """Contrast between the best point and the worst that moves [1], below which no point is reported."""
    equivalent_share: float = 0.02
    """Difference of the explained share [1] within which points explain as well."""
    pixel_z: float = 6.0  # robust standard deviations at which a pixel is an outlier [1]
    min_region_pixels: int = 4  # pixels of a region [count]
    max_regions: int = 5  # regions that are reported, at most [count]


IMAGE_LOCALIZATION = ImageLocalizationThresholds()


@dataclass(frozen=True)
class ImageRenderingSettings:
    """Which frames and Gaussians are looked at. Commit d32643f."""

    max_frames: int = 240  # frames of a recording whose reconstruction is measured, at most [count]
    max_points: int = 64  # points of the moving body, at most [count]
    body_share: float = 0.9  # share of all visible motion that the fewest Gaussians of the body make up [1]


IMAGE_RENDERING = ImageRenderingSettings()


@dataclass(frozen=True)
class VideoCheckSettings:
    """Checks of a video that a fitted run is compared with. Commit 3858606."""

    max_frames: int = 300  # frames looked at where the video file is not there [count]
    shifted_frames: int = 24  # frames on which a shift of the image is expressed in latents [count]
    min_clip_frames: int = 20  # frames of a clip that is kept [count]


VIDEO_CHECKS = VideoCheckSettings()


# --- Inference


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
    min_visibility: float = 0.3
    """Curvature of the misfit along such a direction, in prior standard deviations, that is visible [1]."""


PROBLEM = EstimationProblemSettings()


@dataclass(frozen=True)
class SelectionSettings:
    """Search over effects and their fits."""

    refined_fits: int = 3  # best fits that are refined to convergence [count]. Commit c12aa78.
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
    unmoved_misfit_ratio: float = 1.02
    """Misfit with the nuisance parameters at zero, over that with them fitted [1], from which both
    score tests are made."""
    sample_noise_penalty: float = 4.0
    """Log evidence that an effect on single samples must exceed [nat]; its parameters are not integrated
    out."""


SELECTION = SelectionSettings()


@dataclass(frozen=True)
class CombinationSettings:
    """Sets of several effects."""

    max_effects: int = 3  # effects in a set, at most [count]. Commit 0e95f8e.
    max_first_effects: int = 3  # single effects beside which a second one is sought [count]. Commit 0e95f8e.
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
    elastic_creep_penalty: float = 4.0  # log prior of such creep, lowered by [nat]. Commit 88ac3e6.
    equivalent_log_evidence: float = 3.0
    """Difference of log evidence within which two effects are equivalent [nat]; twice that within one class.
    Commit 0e95f8e."""
    max_probability: float = 0.98  # probability that no name exceeds [1]. Commit 8360ea4.
    law_error: float = 0.03
    """Mean square residual that a right law may leave by its own errors, as a share of the nominal one [1].
    Commit 0fc4d5b."""
    detectable_deviations: float = 2.5
    """Standard deviations of a mean square residual from which an excess is detectable [1]: the one-sided
    false-alarm rate of a normal variable is 0.006."""
    min_unknown: float = 0.015  # probability of `unknown`, at least [1]. Commit 8360ea4.
    unknown_exponent: float = 2.5
    """Exponent of the unexplained share in the odds of `unknown` [1]. Commit df5bf1f."""
    deviation_factor: float = 1.5
    """Factor on a parameter's standard deviation [1], because laws are approximate. Commit 6891504."""
    deviation_floor: float = 0.01
    """Added to that standard deviation [prior standard deviations]. Commit 6891504."""
    set_lead: float = 5.0
    """Log posterior of a set's members above any single effect, where the set explains everything [nat].
    Commit df5bf1f."""
    interval_z: float = 1.645
    """Half width of an interval in standard deviations [1]: the normal quantile of 0.95, for 90 %."""


VERDICT = VerdictSettings()


@dataclass(frozen=True)
class ImplausibilitySettings:
    """Reasons against an explanation that leaves nothing unexplained."""

    unrepeated_chance: float = 0.7
    """P(unknown) where no state recurs without the external force [1]. Commit 0fc4d5b."""
    flexible_chance: float = 0.6  # p(unknown) where two flexible effects are needed [1]. Commit 0fc4d5b.
    relaxed_lead: float = 0.0
    """Log evidence by which the relaxed simulator leads at even odds [nat]. Commit 3570551."""
    relaxed_scatter: float = 2.0  # width of the logistic in that lead [nat]. Commit 3570551.
    state_distance: float = 0.3
    """Distance of two equal states [rms of position and velocity]. Commit dd24cef."""
    passage_periods: float = 0.25
    """Time between a push and a separate passage of the same state [natural periods]. Commit 0fc4d5b."""
    certain_cycles: float = 4.0  # cycles from which a force is surely periodic [count]. Commit 0fc4d5b.
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
    free_memory_clips: int = 3  # clips, the longest, whose memory starts free [count]. Commit c12aa78.
    max_lines: int = 5  # spectral lines tried as a periodic force [count]. Commit 66f7fa5.
    max_line_frequency: float = 0.2  # highest line, over the frame rate [1]. Commit efdf4b2.


PLACEMENT = PlacementSettings()


@dataclass(frozen=True)
class ProfileSettings:
    """Profile likelihoods of fitted parameters."""

    points_per_side: int = 4  # points on each side of the best value [count]. Commit c57c528.
    reach_deviations: float = 3.5  # reach on each side [standard deviations]. Commit c57c528.
    iterations: int = 4  # iterations of each fit [count]. Commit c57c528.
    max_parameters: int = 4  # parameters that are profiled, at most [count]. Commit c57c528.
    pin_deviation: float = 1e-4
    """Prior standard deviation that pins the parameter [its standard deviations]. Commit c57c528."""


PROFILES = ProfileSettings()


@dataclass(frozen=True)
class IdentifiabilitySettings:
    """Which effects a recording could separate."""

    max_effects: int = 8  # effects that are compared, at most [count]. Commit c57c528.


IDENTIFIABILITY = IdentifiabilitySettings()


@dataclass(frozen=True)
class HoldoutSettings:
    """Held-out forecasts."""

    start_samples: int = 10
    """Samples that the initial state is fitted to [count]; repeated samples do not count. Commit 0e95f8e."""
    min_period_share: float = 0.25
    """Length of a block, at least [natural periods], where the simulator cannot be followed longer. Commit
    0fc4d5b."""
    min_block_samples: int = 20  # samples of the shortest block [count]. Commit 0e95f8e.
    diverged_error: float = 10.0
    """Error from which a forecast has diverged [rms of the coordinate]. Commit 6c6edb9."""


HOLDOUT = HoldoutSettings()


@dataclass(frozen=True)
class RecalibrationSettings:
    """Calibration of a given simulator on recordings without an effect."""

    null_evidence_factor: float = 4.0
    """Log evidence that the same errors may reach in another recording, over that in the reference recording
    [1]. Commit 97c6964."""
    degree_steps: tuple[tuple[int, int, int, int], ...] = ((0, 1, 4, 1), (0, 2, 4, 2))
    """Highest degrees of mass, damping, potential and input map that move, step by step [1]. Commit
    937389d."""
    degree_steps_many: tuple[tuple[int, int, int, int], ...] = ((0, 0, 3, 0),)
    """The same where there are many coordinates [1]. Commit 937389d."""
    iterations_factor: int = 2
    """Iterations, over those of an identification [1]; a fitted law is stiffer. Commit 937389d."""
    move_deviation: float = 0.3
    """Prior standard deviation of a move, in units of the acceleration that it changes [1]. Commit
    937389d."""
    max_remaining_misfit: float = 0.9
    """Misfit on windows that were not fitted, over that before [1]. Commit 937389d."""
    direction_samples: int = 400  # samples on which moves are compared [count]. Commit 937389d.
    direction_step: float = 1e-6  # finite-difference step of a move [1]. Commit 937389d.
    direction_cutoff: float = 1e-8
    """Eigenvalue, over the largest one [1], below which a move changes nothing. Commit 937389d."""


RECALIBRATION = RecalibrationSettings()


@dataclass(frozen=True)
class RobustnessSettings:
    """Noise inflation, and repeats of the verdict under perturbations."""

    inflation_misfit: float = 4.0
    """Mean square residual, over the nominal one [1], from which the noise is inflated. Commit 97c6964."""
    min_agreeing: int = 4  # repeats of the five that must agree with the verdict [count]. Commit e6e25e8.
    refitted_effects: int = 3
    """Effects that are fitted again beside those of the verdict [count]. Commit e6e25e8."""
    iterations: int = 4  # iterations of each repeated fit [count]. Commit e6e25e8.
    noise_seeds: tuple[int, ...] = (101, 102)  # seeds of the added noise. Commit e6e25e8.
    frozen_warp_share: float = 1e-6
    """Share of the coordinates' prior warp that is left where none is allowed [1]. Commit e6e25e8."""


ROBUSTNESS = RobustnessSettings()


@dataclass(frozen=True)
class MaterialitySettings:
    """When an effect is too small to be named. Commit 0e95f8e."""

    certain_log_evidence: float = 30.0
    """Log evidence from which an effect is named even if the forecasts hardly improve [nat]. Commit
    0e95f8e."""
    close_floor_ratio: float = 1.5
    """Forecast error over the noise floor [1] up to which no cause is needed. Commit 97c6964."""
    overestimated_noise_misfit: float = 0.5
    """Mean square residual [noise variances] below which the noise was overestimated and no effect is
    needed. Commit 620ccf8."""
    max_closures: int = 4  # candidates whose own closure is computed [count]. Commit 0e95f8e.


MATERIALITY = MaterialitySettings()


# --- Inputs and verdict of the pipelines


@dataclass(frozen=True)
class CalibrationThresholds:
    """When a given simulator is recalibrated, and when inputs are held between samples."""

    missed_misfit: float = 1.5
    """Mean square residual above which a simulator misses its own recordings [noise variances]."""
    min_repeated_share: float = 0.5
    """Share of an input's samples that repeat the one before [1], from which it may be held."""
    min_criterion_gain: float = 10.0
    """Decrease of the Bayesian information criterion for which held inputs are chosen [nat, doubled]."""
    max_misfit_share: float = 0.5
    """Misfit with held inputs, over that without [1], where other windows were used."""


CALIBRATION_CHECKS = CalibrationThresholds()


@dataclass(frozen=True)
class VideoLimits:
    """When images or a moved camera forbid a verdict."""

    max_latents: int = 4000  # nominal latents that a real latent is compared with, at most [count]
    unreadable_error_ratio: float = 5.0
    """Error of the real images, over the nominal one [1], from which states cannot be read."""
    max_camera_share: float = 0.5
    """Motion of the camera, as a share of the gap [1], above which only a camera effect is named."""


VIDEO_LIMITS = VideoLimits()


@dataclass(frozen=True)
class WithheldVerdictSettings:
    """Probabilities where the data forbid a verdict."""

    max_probability: float = 0.4  # probability that no name exceeds there [1]


WITHHELD = WithheldVerdictSettings()
