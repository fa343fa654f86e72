"""Settings of stage 2: the form of the Lagrangian, where it starts and how it is fitted."""

from dataclasses import dataclass, replace
from typing import NamedTuple

from lagsplat import setting_checks as check


class Degrees(NamedTuple):
    """Degrees of the polynomials of a law."""

    potential: int
    inputs: int  # of the volume of each input
    coordinates: int  # of the map from latents to the coordinates of the law; 1: the latents
    matrices: int  # of the frame of mass and damping; 0: constant


@dataclass
class FormConfig:
    """Which terms of the Lagrangian depend on the state, and how large their networks are."""

    mass: str  # 'learned' M(q), 'constant' matrix, or 'induced' by the decoder's Jacobians
    damping: str  # 'learned' C(q) or 'constant' matrix
    potential: str  # 'quadratic', 'icnn' (convex) or 'invex' (convex after a learned diffeomorphism)
    actuation: str  # chamber volumes 'linear', 'concave', or 'bounded': convex, too, as far as K carries it
    rest: str  # 'learned' rest state, or 'fixed' at the encoding of the rest image
    matrix_width: int  # of the two hidden layers behind M and C
    potential_width: int
    actuation_width: int
    diffeo_blocks: int
    diffeo_width: int
    diffeo_lipschitz: float  # bound on every residual branch, below 1 so that the map is invertible
    terms: str  # 'networks', or 'polynomial', for which none of the above counts
    # degrees of a polynomial law; None: as high as the number of coordinates allows
    potential_degree: int | None
    input_degree: int  # of the polynomial volume of each input
    matrix_degree: int | None  # of the frame of M and C; 0: constant
    map_degree: int | None  # of the map from latents to the coordinates of the law; 1: the latents

    @property
    def degrees(self) -> Degrees:
        """Degrees of the polynomials, none of which may be open."""
        potential, coordinates, matrices = self.potential_degree, self.map_degree, self.matrix_degree
        assert potential is not None
        assert coordinates is not None
        assert matrices is not None
        return Degrees(potential, self.input_degree, coordinates, matrices)

    def with_degrees(self, degrees: Degrees) -> "FormConfig":
        """The form with these degrees."""
        return replace(
            self,
            potential_degree=degrees.potential,
            input_degree=degrees.inputs,
            map_degree=degrees.coordinates,
            matrix_degree=degrees.matrices,
        )

    def __post_init__(self) -> None:
        check.require_choice(self, "stage2.form", "mass", ("learned", "constant", "induced"))
        check.require_choice(self, "stage2.form", "damping", ("learned", "constant"))
        check.require_choice(self, "stage2.form", "potential", ("quadratic", "icnn", "invex"))
        check.require_choice(self, "stage2.form", "actuation", ("linear", "concave", "bounded"))
        check.require_choice(self, "stage2.form", "terms", ("networks", "polynomial"))
        check.require_least(self, "stage2.form", 1, "input_degree")
        for least, name in ((2, "potential_degree"), (0, "matrix_degree"), (1, "map_degree")):
            if getattr(self, name) is not None:
                check.require_least(self, "stage2.form", least, name)
        check.require_choice(self, "stage2.form", "rest", ("learned", "fixed"))
        check.require_least(self, "stage2.form", 1, "matrix_width", "potential_width", "actuation_width")
        check.require_least(self, "stage2.form", 1, "diffeo_blocks", "diffeo_width")
        rule = "must lie in (0, 1): at 1 the map may fold, and the potential would have several equilibria"
        lipschitz = self.diffeo_lipschitz
        check.require_setting("stage2.form.diffeo_lipschitz", lipschitz, 0 < lipschitz < 1, rule)


@dataclass
class FloorConfig:
    """Lower bounds that hold whatever the networks learn, relative to the starting matrices.

    ``mass`` and ``stiffness`` multiply the mean eigenvalue of the starting mass and stiffness; ``damping``
    multiplies the mean eigenvalue of the mass per internal time unit, so that it bounds a decay rate.
    """

    mass: float
    damping: float
    stiffness: float

    def __post_init__(self) -> None:
        rule = "must lie in (0, 1): at 0 the energy balance does not hold, above 1 it would replace the fit"
        for name, floor in vars(self).items():
            check.require_setting(f"stage2.floor.{name}", floor, 0 < floor < 1, rule)


@dataclass
class StartConfig:
    """Initial values of the constant parts of M, C, V and nu."""

    source: str
    """'likelihood': the most likely polynomial law; 'fitted': constant matrices by full-batch L-BFGS;
    'isotropic': multiples of the identity."""
    iterations: int  # L-BFGS iterations of the constant fit
    time_unit: str  # 'data': rms velocity / rms acceleration, a period / 2 pi; 'frame': one frame
    damping: float  # of the isotropic start, per time unit, for unit mass
    stiffness: float  # of the isotropic start, per time unit squared, for unit mass

    def __post_init__(self) -> None:
        check.require_choice(self, "stage2.start", "source", ("likelihood", "fitted", "isotropic"))
        check.require_choice(self, "stage2.start", "time_unit", ("data", "frame"))
        check.require_least(self, "stage2.start", 1, "iterations")
        check.require_positive(self, "stage2.start", "damping", "stiffness")


@dataclass
class SelectConfig:
    """How the returned dynamics is chosen: by its rollout error over the training clip."""

    starts: int  # rollouts, evenly spaced over the clip
    periods: float  # length of each, in natural periods (2 pi time units)
    every: int  # optimiser steps between two scores

    def __post_init__(self) -> None:
        check.require_least(self, "stage2.select", 1, "starts", "every")
        check.require_positive(self, "stage2.select", "periods")


@dataclass
class LikelihoodConfig:
    """The fit of a law by maximum likelihood, see `lagsplat.stage2.likelihood`."""

    frames: int  # of the training clips that are used, in stretches spread evenly over them
    iterations: int  # Gauss-Newton steps at most for each length and coupling of the windows
    periods: float  # length of the windows of the last legs, in periods of the slowest mode
    network_iterations: int  # quasi-Newton steps of networks at most

    def __post_init__(self) -> None:
        check.require_least(self, "stage2.likelihood", 1, "frames", "iterations", "network_iterations")
        check.require_positive(self, "stage2.likelihood", "periods")


@dataclass
class Stage2Config:
    """Everything that decides the outcome of stage 2, less the chart and the seed."""

    form: FormConfig
    floor: FloorConfig
    start: StartConfig
    stride_frames: int  # between the four samples of a one-step window
    integrator: str  # 'verlet', under inputs held over a frame, or 'runge_kutta', which interpolates them
    longest_step: float
    """Of the integrator, in time units; frames further apart take several steps. A law of maximum likelihood
    takes as many as its modes need."""
    ridge: float  # rho: caps the ratio of weights between two latent directions at 1 / rho
    velocity_weight: float  # of the velocity term against the position term
    effort: float  # share of all steps below that is taken: a profile's, where the others are a system's
    steps: int  # of the one-step objective
    batch: int  # windows a step
    lr: float  # Adam
    final_fraction: float  # of the rate, reached at the last step on a cosine; 1 keeps it constant
    gradient_clip: float
    select: SelectConfig
    likelihood: LikelihoodConfig

    def __post_init__(self) -> None:
        check.require_choice(self, "stage2", "integrator", ("runge_kutta", "verlet"))
        if self.form.terms == "polynomial":
            rule = "is for networks: take stage2=networks, or leave 'likelihood' and 'runge_kutta'"
            check.require_setting(
                "stage2.start.source", self.start.source, self.start.source == "likelihood", rule
            )
            check.require_setting(
                "stage2.integrator", self.integrator, self.integrator == "runge_kutta", rule
            )
        rule = "must be positive: a direction that nothing can see would be left unconstrained"
        check.require_setting("stage2.ridge", self.ridge, self.ridge > 0, rule)
        check.require_positive(self, "stage2", "stride_frames", "longest_step", "batch")
        check.require_positive(self, "stage2", "lr", "gradient_clip")
        check.require_least(self, "stage2", 0, "velocity_weight", "steps")
        check.require_interval(self, "stage2", "(0, 1]", "effort", "final_fraction")
