"""Settings and thresholds of a diagnosis.

`DiagnoseConfig` holds what users set in ``conf/diagnose``. The constants after it are every other number that
can change a verdict, one class a subject, read as ``VERDICT.credible``; no class is instantiated. Each number
has its unit in brackets (``[1]`` is a ratio) and its source.

No number here is the result of a fitted calibration yet. The source is the commit of this repository in which
a value was set by hand: after a semicolon beside the value, or beside its class for all others. Commits
before 0de462e precede every sealed split of the benchmark. Later ones followed the opening of one split or
more (22a8644 opened blind-1, 5353e65 blind-2, a61a354 two small splits, 95ad2a5 blind-6), so that their
values may have been chosen with a spent split in view.
"""

from dataclasses import dataclass, replace
from typing import Any

from lagsplat.io.config import require_joint_unit
from lagsplat.setting_checks import require_least, require_positive, require_setting

TOLERANCES = ("potential", "damping", "inputs", "inertia", "offset", "warp")
"""Settings that say how uncertain a simulator's own parameters are."""


@dataclass
class DiagnoseConfig:
    """What a user sets of a diagnosis: ``conf/diagnose/default.yaml`` gives units, ranges and sources."""

    input_hold: str  # inputs between samples: `linear` or `zoh` (zero-order hold)
    columns: dict[str, str]  # columns of a table that have other names: `{t: time, q0: angle, u0: torque}`
    joint_unit: str | None  # of joints in a LeRobot dataset: degree, radian, as_written; None by a rule
    joints: list[str] | None  # joints of a MuJoCo model that are the coordinates; None for all
    actuators: list[str] | None  # actuators of a MuJoCo model that are the inputs; None for all
    parameters: str | None  # file of mujoco.sysid whose values replace those of a MuJoCo model; None for none
    max_coupled: int  # joints of a MuJoCo model above which each is diagnosed by itself, if driven so [count]
    targets: dict[str, str]  # inputs that are position targets, each with its coordinate: `{u0: q0}`
    without: list[str]  # effects that are left out of the catalogue
    film_d: int  # coordinates of the mechanism in a film that is the simulator [count]
    film_profile: str  # profile of the run that is fitted to such a film
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
    inertia: float  # prior standard deviation of the inertia along each of several coordinates, relative [1]
    offset: float  # prior standard deviation of a constant force [rms of the motion's acceleration]
    warp: float  # prior standard deviation of a smooth distortion of the coordinates [their range]
    learned_factor: float  # factor on these six where the simulator was learned from a video [1]
    reference_longest_s: float  # duration of a simulator's own recordings that is used, at most [s]
    materiality: float  # share of the gap that an effect must remove beyond a refit to be named [1]

    def __post_init__(self) -> None:
        hold = self.input_hold
        rule = "must be linear or zoh (held between samples)"
        require_setting("diagnose.input_hold", hold, hold in ("linear", "zoh"), rule)
        require_joint_unit("diagnose.joint_unit", self.joint_unit)
        positive = ("reference_longest_s", "window_periods", "steps_per_period", "tolerance")
        require_positive(self, "diagnose", *positive, "effective_sample_ratio", "identify_ridge")
        require_least(self, "diagnose", 1, "film_d", "max_coupled", "identify_iterations")
        require_least(self, "diagnose", 1, "families", "places", "starts", "iterations")
        for name in (*TOLERANCES, "materiality"):
            value = getattr(self, name)
            require_setting(f"diagnose.{name}", value, 0 < value < 1, "must lie between 0 and 1")

    @property
    def model_choice(self) -> dict[str, Any]:
        """What is taken of a MuJoCo model, as the keywords of what loads it."""
        return {"joints": self.joints, "actuators": self.actuators, "parameters": self.parameters}

    def scale_tolerances(self, factor: float) -> "DiagnoseConfig":
        """The same with the sim's own parameters ``factor`` times as uncertain, at most 0.5."""
        return replace(self, **{name: min(factor * getattr(self, name), 0.5) for name in TOLERANCES})

    def without_tolerances(self) -> "DiagnoseConfig":
        """The same with the sim's own parameters as good as certain."""
        return self.scale_tolerances(VERDICT.exactness)


# --- Data quality


class CLOSED_LOOP:
    """Tests for inputs that a controller computes from the measured motion. Commit d06fac6."""

    difference_order: int = 6  # order of the differences that leave errors and no smooth motion [count]
    min_power_growth: float = 1.2  # growth of the power by one difference [1]: noise 3.7, smooth less than 1
    step_ratio: float = 8.0  # change between two samples, in usual changes [1], from which an input steps
    max_controller_lag: int = 4  # samples that a controller may take to respond [count]
    min_explained_share: float = 0.1  # share of an input's own error that the errors of q must explain [1]
    max_p_value: float = 1e-6  # probability that chance explains as much [1]: one false alarm in a million
    min_static_share: float = 0.95  # share that a static function of q and v explains, without noise [1]
    max_relative_acceleration: float = 0.5  # over the restoring one [1]; slower motion follows any input
    single_line_share: float = 0.9  # power in one spectral line [1] that q and v follow whatever the cause


class COMPATIBILITY:
    """Whether the real motion lies where the simulator was seen, and in the same units. Commit d06fac6."""

    period_ratio_warning: float = 2.0  # ratio of both sides' driven periods [1] from which neither is trusted
    region_factor: float = 1.5  # size of the simulator's region, in its 99 % quantile of the distance [1]
    warning_outside_share: float = 0.05  # share of real samples outside of it that is worth a warning [1]
    undetermined_outside_share: float = 0.5  # share of real samples outside that forbids a verdict [1]
    max_center_offset: float = 6.0  # distance of both motions' middles, in the sim's standard deviations [1]
    unit_ratio_tolerance: float = 0.35  # relative error of a ratio of sizes that is a ratio of units [1]
    striking_size_ratio: float = 20.0  # ratio of sizes that asks for an explanation [1]
    constant_tolerance: float = 1e-6  # variation of a constant input over its size [1]: printed digits


class DISCONTINUITIES:
    """Where a trajectory is not continued: cuts, gaps, holds before a release. Commits d06fac6, 71ca292."""

    polynomial_samples: int = 8  # samples of the polynomial on either side of a border, at most [count]
    polynomial_periods: float = 0.15  # duration of that polynomial, at most [natural periods]
    jump_standard_errors: float = 8.0  # jump, in standard errors [1], from which it is significant
    knock_ratio: float = 2.0  # jump over what a knock between two samples could displace [1]
    mismatch_ratio: float = 3.0  # jump over the usual mismatch, by the motion's curvature, around it [1]
    mismatch_quantile: float = 0.9  # quantile of the mismatches around a jump that counts as usual [1]
    neighborhood_lengths: int = 6  # polynomial lengths to either side that count as around [1]
    isolated_step_share: float = 0.5  # share of the jump by which the step exceeds its neighbors [1]
    min_range_share: float = 0.03  # jump over the range of the motion around it [1]
    rate_mismatch_ratio: float = 0.4  # difference of the rates on both sides, in typical speeds [1]
    max_cuts_per_period: float = 0.5  # cuts in one natural period above which they are no cuts [count]
    max_lost_frames: float = 10.5  # frames that a camera loses at once, at most [count]
    min_gap_steps: float = 3.0  # length of a gap, in sampling steps [1]
    min_gap_periods: float = 0.125  # length of a gap, in natural periods [1]; a gap exceeds both
    missing_steps: float = 1.5  # step in time, over the usual, from which on a sample is missing [1]
    max_input_error: float = 0.1  # error of an input that is interpolated across a gap, over its rms [1]
    min_hold_periods: float = 0.4  # duration of a hold [natural periods]
    min_hold_offset: float = 0.7  # distance of a hold from the middle of the next swing, in amplitudes [1]
    max_hold_motion: float = 0.2  # motion during a hold, in amplitudes of the swing after it [1]
    min_swing_noise_ratio: float = 12.0  # amplitude of that swing over the noise [1]


class REPEATED_FRAMES:
    """Samples that repeat an earlier one, as from a camera that lost frames. Commits d06fac6, 71ca292."""

    same_image_steps: float = 3.0  # step, in those that noise makes, up to which an image is the same [1]
    jump_steps: float = 6.0  # step, in those that noise makes, from which the image has jumped [1]
    max_repeats: int = 200  # samples in a row that an image may stay the same [count]
    curvature_lag: int = 3  # samples over which the curvature of the motion is measured [count]
    curvature_quantile: float = 0.95  # quantile of the curvature that counts as usual [1]
    neighbor_samples: int = 5  # samples on either side of a repeat through which a polynomial is laid [count]
    polynomial_degree: int = 3  # degree of that polynomial [1]
    significant_miss: float = 5.0  # distance of a repeat from the polynomial, at least, in noise steps [1]
    curvature_margin: float = 1.3  # curvature during the repeat over the usual one [1]
    neighbor_misfit_share: float = 0.1  # share of that distance by which neighbors may miss it too [1]
    min_certain_repeats: int = 5  # certain repeats from which shorter ones count too [count]
    min_uncertain_length: int = 4  # samples of such a shorter repeat [count]


class EXCITATION:
    """Log evidence from which an effect would show (Kass and Raftery 1995)."""

    strong: float = 3.0  # 20 to 1 [nat]
    positive: float = 1.0  # 3 to 1 [nat]


class NATURAL_PERIOD:
    """Weak-form regression of a linear law for the natural period. Commit d06fac6."""

    lengths_per_decade: int = 14  # lengths of test functions tried in a decade [count]
    min_test_samples: int = 9  # samples of the shortest test function [count]
    max_samples: int = 6000  # samples of all clips together; longer ones are decimated [count]
    min_explained_share: float = 0.3  # share of the weighted accelerations that the law must explain [1]
    min_surplus: float = 2.0  # independent test functions beyond the unknowns [count]; fewer fit any law
    max_stiffness_error: float = 0.15  # relative standard error of a stiffness [1] from which it is dropped
    turn_size: float = 0.1  # return of the motion, in its standard deviations [1], that counts as a turn
    min_mode_share: float = 0.08  # share of the motion that the slowest mode must carry [1]
    min_spectrum_samples: int = 16  # samples of the shortest clip whose spectrum is taken [count]
    step_period_ratio: float = 1.6  # period of coordinates over that of rates [1] from which motion steps


class NOISE_ESTIMATION:
    """Moving-window polynomial fit that separates noise from motion. Commit d06fac6."""

    window_widths: tuple[int, ...] = (24, 48, 96)  # samples of a window [count]
    window_degrees: tuple[int, ...] = (5, 9, 13, 17, 21, 29)  # degrees of the polynomials in a window [1]
    degrees_per_period: float = 20.0  # degree that a period of motion takes, at least [1]: five for a quarter
    residual_share: float = 0.5  # of that degree that a fit's residual takes [1], which is no motion whole
    guard_degrees: int = 3  # next degrees, in which motion shows first [count]
    guard_agreement: float = 1.25  # noise in them over the noise beyond [1]; above, there is motion
    fast_degree: int = 7  # degree in the shortest windows [1]: at 10 samples a period 3e-4 of the swing
    min_window: int = 9  # samples of the shortest window [count]
    min_windows: int = 4  # windows in which lasting noise is sought, at least [count]
    max_windows: int = 600  # windows looked at, evenly over the motions [count]
    student_t_freedom: float = 4.0  # of Student's t [1]; heavy tails, as kinks fall into some windows
    correlation_range: tuple[float, float, int] = (0.1, 0.98, 24)  # of neighbours [first, last, count]
    max_alternation: float = 0.6  # size of a negative one [1]
    correlated_log_ratio: float = 6.0  # log-likelihood by which correlated noise must beat white noise [nat]


class SAMPLING:
    """How densely, evenly and finely a motion is sampled. Commit d06fac6."""

    decimated_samples_per_period: float = 40.0  # samples kept in the rms period of the rates [count]: as many
    # as the integrator's steps
    decimated_rate_hz: float = 50.0  # rate that decimation keeps [Hz]
    fine_rate_hz: float = 120.0  # rate that it keeps where samples repeat, or joints drive others [Hz]
    repeat_noise_ratio: float = 4.0  # step that the motion makes where a value repeats, over the noise [1]
    coarse_samples_per_period: float = 8.0  # samples in a period below which a warning is due [count]
    min_samples_per_period: float = 4.0  # samples in a period below which nothing is computed [count]
    slowest_step_s: float = 0.9  # step between samples [s] from which times may be in ms: 1 kHz is 1
    slowest_period_s: float = 100.0  # natural period [s] from which they may be, too: of a rope of 2.5 km
    quantization_share: float = 0.1  # quantization step over the coordinate's rms [1] that is worth a note
    clipped_share: float = 0.02  # share of samples at an extreme [1] from which a sensor saturates
    clipped_run: int = 4  # samples in a row at that extreme [count]
    max_repeats: int = 10  # repeats in a row that are a lost frame [count]; more are a rest
    rest_noise_ratio: float = 3.0  # motion over the noise [1] below which nothing moves
    block_periods: float = 1.5  # duration of a block whose sampling is judged [natural periods]
    block_samples: int = 60  # samples of such a block, at least [count]
    min_inertial_share: float = 0.03  # inertial over restoring force [1] that shows: `VERDICT.law_error`
    min_blocks: int = 8  # blocks from which a comparison is made [count]
    min_periods: float = 2.5  # duration of a recording [natural periods] below which too little repeats


class TIME_ALIGNMENT:
    """Whether inputs and coordinates share a clock. Commit d06fac6."""

    max_shift_periods: float = 3.0  # shift of the inputs, at most [natural periods]
    shifts_per_period: int = 16  # shifts tried in one natural period [count]
    gross_shift_periods: float = 0.5  # shift that no delay of mechanism or line explains [natural periods]
    poor_explained_share: float = 0.6  # share explained [1] below which the given times are questioned
    min_share_gain: float = 0.35  # gain of the explained share [1] that decides for a shift
    min_periods: float = 6.0  # duration of a recording [natural periods] below which chance fits some shift
    fair_explained_share: float = 0.85  # share explained [1] below which they are too, with `min_error_ratio`
    min_error_ratio: float = 4.0  # ratio by which a shift must shrink what is not explained [1]
    max_aperiodic_share: float = 0.02  # power that a period may leave [1]: an input sensor's error of 1/10
    equal_period_error: float = 0.02  # relative difference of periods [1] that count as one
    min_input_samples: int = 32  # samples of a clip whose input may be periodic [count]
    max_input_samples: int = 20000  # samples at which an input is compared with itself, at most [count]
    unlike: float = 0.5  # square difference of stretches, over that of unrelated ones [1], without likeness


# --- Residual


class CHANGE_POINTS:
    """Events: stretches in which the residual is larger than around them. Commit 09186ef."""

    stride_periods: float = 0.125  # distance of the levels among which changes are sought [natural periods]
    window_periods: float = 0.5  # moving window [natural periods] over which the square of a swing is level
    log_level_variance: float = 0.5  # variance of a level's logarithm where nothing changes [1]
    merge_log_ratio: float = 2.0  # difference of two neighbors' log levels [1] below which they are one event
    edge_share: float = 0.25  # share of its peak [1] at which an event begins and ends
    min_energy_share: float = 0.02  # share of the residual's energy below which an event is not reported [1]
    false_discovery_rate: float = 0.05  # rate of false discoveries [1]
    max_events: int = 5  # events that are reported, at most [count]


class ERROR_BUDGET:
    """Shares of the forecast error by stage, and whether images can be trusted. Commit 6e0f2c7."""

    bootstrap_draws: int = 999  # draws of the block bootstrap [count]
    coverage: float = 0.95  # coverage of its intervals [1]
    suspect_error_ratio: float = 2.0  # error of real over nominal images [1] that makes perception suspect
    suspect_outside_share: float = 0.05  # share of frames outside the nominal latents [1] that does so
    outside_quantile: float = 0.999  # quantile of the nominal distances beyond which a frame is outside [1]
    max_relative_error: float = 1e3  # error that a diverged forecast counts with [rms of the coordinate]
    max_step_share: float = 0.02  # step of the forecast's integrator, as a share of the horizon, at most [1]


class RESIDUAL_CORRELATION:
    """Correlations of the residual, and the blocks that are independent. Commit 09186ef."""

    block_periods: float = 0.75  # length of a block [natural periods]
    correlation_z: float = 1.96  # correlation, in standard deviations [1]: the normal quantile of 0.975


class LATENT_FORCE:
    """Smoother of the force that the simulator lacks. Commit 6c919a8."""

    length_scales_periods: tuple[float, ...] = (0.125, 0.5, 2.0)  # length scales tried [natural periods]
    path_tolerance: float = 1e-3  # change of the path, over its rms [1], that ends the iteration
    max_iterations: int = 5  # relinearizations, at most [count]
    max_step_rad: float = 0.5  # Runge-Kutta step of a transition matrix, at most [rad of the fastest mode]
    start_force_share: float = 0.01  # variance of the force at the start, over the acceleration's [1]
    min_log_likelihood_gain: float = 3.0  # gain that admits a force [nat]; by chance in 1 of 100 records


class SPECTRUM:
    """Multitaper spectrum of the residual (Thomson 1982, doi:10.1109/PROC.1982.12433). Commit 09186ef."""

    half_bandwidth: float = 3.0  # time-bandwidth product of the tapers [1]
    tapers: int = 5  # number of tapers [count]: twice the product less one
    padding: int = 6  # zero padding of the transform [1]: a line between two frequencies is not noise
    min_clip_periods: float = 3.0  # duration of a clip that has a spectrum [natural periods]
    max_frequency_ratio: float = 12.0  # highest frequency, in natural frequencies [1]
    line_false_alarm_rate: float = 0.01  # probability of a false line [1]
    band_edge_share: float = 0.1  # share of its peak [1] at which a band begins and ends
    min_band_share: float = 0.05  # share of the power below which a band is not reported [1]
    min_relative_power: float = 1e-3  # power over the largest one [1] below which coherence means nothing
    max_bands: int = 5  # bands that are reported, at most [count]


class STATE_MAPS:
    """Permutation tests of maps over position and velocity, and of the measurement. Commit 09186ef."""

    map_bins: int = 8  # bins of a map in each direction [count]
    profile_bins: int = 12  # bins of a profile [count]
    sign_flips: int = 999  # random sign flips of the permutation test [count]
    significance: float = 0.05  # level of that test [1]
    cluster_standard_errors: float = 2.0  # standard errors at which a bin joins a cluster [1]
    min_blocks: int = 6  # blocks of a test [count]: 2^6 sign patterns are the fewest for a level of 0.05


# --- Estimation


class ESTIMATION:
    """How recordings become data, and the Gauss-Newton steps of multiple shooting. Commit 66f7fa5."""

    min_relative_noise: float = 1e-3  # assumed noise, at least, over the rms of the coordinate [1]
    region_margin: float = 0.15  # margin around the visited region, as a share of half its range [1]
    missing_steps: float = 1.75  # step in which a sample is missing, over the median [1]: two, less jitter
    max_stale_steps: int = 4  # steps after which all derivatives are computed anew [count]
    max_attempts: int = 6  # damping factors tried for one step before the fit ends [count]


# --- Identification


class NOVELTY:
    """Windows where a simulator was never seen, and outliers of its own recordings. Commit 937389d."""

    distance_quantile: float = 0.999  # quantile of the reference distances beyond which a window is new [1]
    poor_misfit: float = 4.0  # mean square from which outlier windows are sought [noise variances]
    good_misfit: float = 1.5  # mean square up to which the other windows are explained [noise variances]
    outlier_ratio: float = 4.0  # mean square of an outlier window over the median [1]
    max_remaining_share: float = 0.25  # share of the mean square that the other windows may leave [1]
    max_outliers: int = 3  # outlier windows, at most [count]
    min_windows_per_outlier: int = 4  # windows for each outlier, at least [count]
    min_windows: int = 8  # windows from which outliers are sought [count]: fewer have no reliable median


class IDENTIFICATION:
    """Fits of a simulator to its own recordings. Commit 66f7fa5, the four from ``window_scales`` on 0e95f8e.

    Inputs that step may be held between samples; the last three choose.
    """

    max_inertia_coupling: float = 0.3  # prior standard deviation between two coordinates, over their own [1]
    min_misfit_reduction: float = 0.2  # share of the misfit that a costly larger structure must remove [1]
    coefficient_deviation: float = 3.0  # prior standard deviation about the estimate, in its field's unit [1]
    equivalent_misfit_ratio: float = 1.02  # misfit, over the least one [1], up to which a simpler law does
    test_width_factors: tuple[float, ...] = (1.0, 0.5, 0.25)  # lengths of test functions, over the usual [1]
    diverged_misfit: float = 50.0  # mean square residual of windows too long to follow [noise variances]
    fit_tolerance: float = 1e-4  # gain of a step that ends the fit, as a share of the misfit [1]
    linearised_windows: int = 32  # windows by which larger structures are compared, at most [count]
    window_scales: tuple[float, float] = (0.35, 0.12)  # window lengths about an unstable rest, relative [1]
    min_window_frames: int = 12  # frames of a window, at least [count]
    symmetrizer_prior: float = 0.1  # weight of a unit inertia beside symmetric stiffness and damping [1]
    min_inertia: float = 0.05  # smallest principal inertia in scaled coordinates, over the largest [1]
    min_repeated_share: float = 0.5  # share of input samples that repeat [1] where they may be held
    min_hold_gain: float = 10.0  # decrease of the BIC that chooses held inputs [nat, doubled]
    max_hold_misfit_share: float = 0.5  # misfit with over without held inputs [1], where windows differ


# --- Given simulators


class JOINTS:
    """Chains whose joints are diagnosed one by one."""

    gain_poses: int = 50  # poses at which the gain of a motor is measured [count]
    gain_tolerance: float = 1e-6  # change of a gain, or gain on another joint, over the gain [1]: rounding


class PROJECTION:
    """Projection of a given simulator on polynomial fields. Commit 692b79f."""

    warning_error: float = 0.02  # relative error of the acceleration [1] worth a warning; commit 3c11127
    tolerance: float = 0.003  # relative error of the acceleration below which no field is added [1]
    default_friction_width: float = 0.02  # of smooth dry friction, unless another fits [rms of the speed]
    friction_widths: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2)  # widths tried [rms of the speed]


# --- Images and videos


class IMAGES:
    """Where in the image a force acts, and where it is wrong. Commit 6e0f2c7, the last three d32643f."""

    min_contrast: float = 0.05  # contrast of the best to the worst moving point, to report the best [1]
    equivalent_share: float = 0.02  # difference of the explained share [1] within which points are equal
    pixel_z: float = 6.0  # robust standard deviations at which a pixel is an outlier [1]
    min_region_pixels: int = 4  # pixels of a region [count]
    max_regions: int = 5  # regions that are reported, at most [count]
    max_frames: int = 240  # frames of a recording whose reconstruction is measured, at most [count]
    max_points: int = 64  # points of the moving body, at most [count]
    body_share: float = 0.9  # share of all visible motion that the fewest Gaussians of the body make up [1]


class VIDEO_CHECKS:
    """Checks of a video that a fitted run is compared with. Commit 3858606, but for the last three."""

    max_frames: int = 300  # frames looked at where the video file is not there [count]
    shifted_frames: int = 24  # frames on which a shift of the image is expressed in latents [count]
    min_clip_frames: int = 20  # frames of a clip that is kept [count]
    max_latents: int = 4000  # nominal latents that a real latent is compared with, at most [count]
    unreadable_error_ratio: float = 5.0  # error of real over nominal images [1] that hides the states
    max_camera_share: float = 0.5  # camera's share of the gap [1] above which only it is named


# --- Inference


class PROBLEM:
    """Which windows and directions enter an estimation, and where effects are tried."""

    plausible_quantile: float = 0.999  # of chi-squared: prior distance that parameters plausibly have [1]
    min_window_frames: int = 20  # frames of a window, at least [count]
    min_explained_share: float = 0.5  # share of the motion explained in windows of full length [1]
    min_known_share: float = 0.7  # share of windows a sim must know before others are left out [1]; 937389d
    max_open_directions: int = 6  # directions that identification leaves open, at most [count]; 0e95f8e
    min_visibility: float = 0.3  # misfit's curvature along a visible one, in prior standard deviations [1]
    max_joint_coordinates: int = 3  # coordinates up to which pairs of them are tried [count]; 71ce7a9
    free_memory_clips: int = 3  # clips, the longest, whose memory starts free [count]; c12aa78
    max_lines: int = 5  # spectral lines tried as a periodic force [count]; 66f7fa5
    max_line_frequency: float = 0.2  # highest line, over the frame rate [1]; efdf4b2


class SELECTION:
    """Search over effects, sets of several effects, and their fits."""

    tested_windows: int = 12  # windows on which effects are tested and tried, at most [count]
    trial_iterations: int = 4  # iterations after which fits are compared and poor ones given up; 9b038105
    min_families: int = 3  # effects that are tried beside another, at least [count]; 0e95f8e
    continued_sets: int = 2  # best fits that are continued where a further effect is sought [count]; 9b038105
    refined_sets: int = 1  # of these, fits that are refined to convergence [count]; 9b038105
    refined_fits: int = 3  # best fits that are refined to convergence [count]; c12aa78
    refined_iterations: int = 5  # iterations of a refined fit, over those of the first fit [1]; c12aa78
    refined_tolerance: float = 0.03  # tolerance of a refined fit, over that of the first fit [1]; c12aa78
    max_noise_correlation: float = 0.5  # of residuals [1], from which sample effects explain nothing; 8279c95
    visible_repeat_misfit: float = 4.0  # by which visible repeats miss the motion [noise variances]; 97b9096
    start_shares: tuple[float, ...] = (1.0, 0.5, 0.25, 0.1, 0.03)  # of the score's amplitude [1]; 123f88b
    unmoved_misfit_ratio: float = 1.02  # misfit, nuisances at zero over fitted [1], that asks for both tests
    sample_noise_penalty: float = 4.0  # log evidence a sample effect must exceed [nat]: not integrated out
    max_effects: int = 3  # effects in a set, at most [count]; 0e95f8e
    max_first_effects: int = 3  # single effects beside which a second one is sought [count]; 0e95f8e
    # mean square over the nominal [1] that asks for shorter windows, then inflates the noise; 97c6964
    inflation_misfit: float = 4.0
    min_excess: float = 0.1  # excess mean square that asks for another effect [noise variances]; 123f88b


class VERDICT:
    """The verdict beside its calibrated probabilities."""

    credible: float = 0.9  # share of the probability that effects hold which the data do not tell apart [1]
    open_gap: float = 1.3  # held-out error after a refit, over its floor [1], from which a gap is left open
    max_withheld_probability: float = 0.4  # of any name where the data forbid a verdict [1]
    deviation_factor: float = 1.5  # on a standard deviation [1], as laws are approximate; 6891504
    deviation_floor: float = 0.01  # added to that standard deviation [prior standard deviations]; 6891504
    interval_z: float = 1.645  # half width of a 90 % interval [standard deviations]: the quantile of 0.95
    max_closures: int = 4  # candidates whose own closure is computed [count]; 0e95f8e
    exactness: float = 1e-3  # factor on tolerances that leaves hardly any [1]; fits divide by them
    relaxation: float = 60.0  # factor on prior deviations [1]: thousandths become tens of per cent; 0fc4d5b


class RECURRENCE:
    """Whether a recording shows that a force comes from outside. Commit 0fc4d5b."""

    state_distance: float = 0.3  # distance of two equal states [rms of position and velocity]; dd24cef
    passage_periods: float = 0.25  # time from a push to another passage [natural periods]
    certain_cycles: float = 4.0  # cycles from which a force is surely periodic [count]
    min_push_share: float = 0.1  # strength of a push over the strongest [1] below which it is none


class PROFILES:
    """Profile likelihoods, and which effects a recording could separate. Commit c57c528."""

    points_per_side: int = 4  # points on each side of the best value [count]
    reach_deviations: float = 3.5  # reach on each side [standard deviations]
    iterations: int = 4  # iterations of each fit [count]
    max_parameters: int = 4  # parameters that are profiled, at most [count]
    pin_deviation: float = 1e-4  # prior standard deviation that pins a parameter [its standard deviations]
    max_compared_effects: int = 8  # effects whose separability is computed, at most [count]


class HOLDOUT:
    """Held-out forecasts."""

    start_samples: int = 10  # samples, without repeats, that fit the initial state [count]; 0e95f8e
    min_period_share: float = 0.25  # length of a block where the sim soon diverges [natural periods]; 0fc4d5b
    min_block_samples: int = 20  # samples of the shortest block [count]; 0e95f8e
    most_error: float = 1e3  # error that a diverged forecast counts with, at most [rms of the coordinate]
    diverged_error: float = 10.0  # error of a diverged forecast, at least [rms of the coordinate]; 6c6edb9


class RECALIBRATION:
    """Calibration of a given simulator on recordings without an effect. Commit 937389d.

    The degrees are the highest of mass, damping, potential and input map that move, step by step [1].
    """

    # With exponential tails the best of n = 60 effects has an evidence like s (ln n + G), G of a Gumbel
    # distribution: one recording's best exceeds this factor times another's in one case of twenty.
    null_evidence_factor: float = 1.85  # log evidence in another recording, over the reference's [1]
    missed_misfit: float = 1.5  # mean square from which a sim misses its recordings [noise variances]
    degree_steps: tuple[tuple[int, int, int, int], ...] = ((0, 1, 4, 1), (0, 2, 4, 2))
    degree_steps_many: tuple[tuple[int, int, int, int], ...] = ((0, 0, 3, 0),)  # of many coordinates
    iterations_factor: int = 2  # iterations over an identification's [1]; a fitted law is stiffer
    move_deviation: float = 0.3  # prior standard deviation of a move, in acceleration that it changes [1]
    max_remaining_misfit: float = 0.9  # misfit on windows that were not fitted, over that before [1]
    direction_samples: int = 400  # samples on which moves are compared [count]
    direction_step: float = 1e-6  # finite-difference step of a move [1]
    direction_cutoff: float = 1e-8  # eigenvalue over the largest [1] below which a move changes nothing


class EXPERIMENT:
    """Experiments that are compared for what to record next, and repeats that are checked."""

    periods: float = 10.0  # length of most of them [natural periods]
    min_samples: int = 100  # samples of the shortest [count]
    lines: int = 12  # sines in a multisine [count]
    seeds: int = 2  # draws of what has random phases or levels [count]
    levels: tuple[float, ...] = (1.0, 0.7, 0.5, 0.35, 0.25, 0.17)  # amplitudes over the recorded ones [1]
    versions: int = 3  # levels compared of each experiment, the largest that stay in range [count]
    payload: float = 0.5  # inertia of a payload, over the mechanism's own [1]
    rate_quantile: float = 0.999  # of the recorded rates of an input [1]: the fastest without a glitch
    reach: float = 1.2  # distance from the middle of the visited range, over the farthest recorded [1]
    refit_steps: int = 3  # Gauss-Newton steps by which a rival imitates the truth [count]
    draws: int = 4  # draws of both hypotheses' parameters [count]
    suggestions: int = 3  # experiments that are suggested, at most [count]
    decisive: float = 5.0  # log Bayes factor [nat] that is very strong, Kass & Raftery 1995,
    # doi:10.1080/01621459.1995.10476572
    bare: float = 1.0  # the same that is not worth more than a bare mention [nat]
