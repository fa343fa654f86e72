"""Settings of stage 2: the form of the Lagrangian, where it starts and how it is fitted."""

from dataclasses import dataclass


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

    def __post_init__(self) -> None:
        choices = {
            "mass": ("learned", "constant", "induced"),
            "damping": ("learned", "constant"),
            "potential": ("quadratic", "icnn", "invex"),
            "actuation": ("linear", "concave", "bounded"),
            "rest": ("learned", "fixed"),
        }
        for name, allowed in choices.items():
            if getattr(self, name) not in allowed:
                raise ValueError(
                    f"stage2.form.{name}={getattr(self, name)!r}: choose one of {', '.join(allowed)}"
                )
        for name in ("matrix_width", "potential_width", "actuation_width", "diffeo_blocks", "diffeo_width"):
            if getattr(self, name) < 1:
                raise ValueError(f"stage2.form.{name}={getattr(self, name)} must be at least 1")
        if not 0 < self.diffeo_lipschitz < 1:
            raise ValueError(
                f"stage2.form.diffeo_lipschitz={self.diffeo_lipschitz} must lie in (0, 1): at 1 the residual "
                "map may fold, and the potential would have several equilibria"
            )


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
        for name in ("mass", "damping", "stiffness"):
            if not 0 < getattr(self, name) < 1:
                raise ValueError(
                    f"stage2.floor.{name}={getattr(self, name)} must lie in (0, 1): without a floor the "
                    "energy balance does not hold, and above the fitted scale it replaces the fit"
                )


@dataclass
class StartConfig:
    """Initial values of the constant parts of M, C, V and nu."""

    source: str  # 'fitted': constant matrices by full-batch L-BFGS; 'isotropic': multiples of the identity
    iterations: int  # L-BFGS iterations of the constant fit on one step
    shooting_iterations: int  # and then on rollouts of one natural period; 0 leaves them out
    time_unit: str  # 'data': rms velocity / rms acceleration, a period / 2 pi; 'frame': one frame
    damping: float  # of the isotropic start, per time unit, for unit mass
    stiffness: float  # of the isotropic start, per time unit squared, for unit mass

    def __post_init__(self) -> None:
        if self.source not in ("fitted", "isotropic"):
            raise ValueError(f"stage2.start.source={self.source!r}: choose 'fitted' or 'isotropic'")
        if self.time_unit not in ("data", "frame"):
            raise ValueError(f"stage2.start.time_unit={self.time_unit!r}: choose 'data' or 'frame'")
        if self.iterations < 1 or self.shooting_iterations < 0:
            raise ValueError(
                f"stage2.start.iterations={self.iterations} must be at least 1 and "
                f".shooting_iterations={self.shooting_iterations} not negative"
            )
        if min(self.damping, self.stiffness) <= 0:
            raise ValueError("stage2.start.damping and .stiffness must be positive")


@dataclass
class SelectConfig:
    """How the returned dynamics is chosen: by its rollout error over the training clip."""

    starts: int  # rollouts, evenly spaced over the clip
    periods: float  # length of each, in natural periods (2 pi time units)
    every: int  # optimiser steps between two scores

    def __post_init__(self) -> None:
        if min(self.starts, self.every) < 1 or self.periods <= 0:
            raise ValueError("stage2.select.starts and .every must be at least 1 and .periods positive")


@dataclass
class ShootConfig:
    """Refinement by multi-step shooting from encoded states; ``steps: 0`` leaves it out."""

    steps: int
    batch: int  # windows a step of the last leg; shorter windows come in larger batches
    lr: float
    periods: float  # final length of a window, in natural periods; it grows to this from half
    anchor: float  # price on leaving the start where the clip says nothing, in present errors; 0 for none

    def __post_init__(self) -> None:
        if self.steps < 0 or self.batch < 1:
            raise ValueError(
                f"stage2.shoot.steps={self.steps} must be 0 or more and .batch={self.batch} at least 1"
            )
        if min(self.lr, self.periods) <= 0:
            raise ValueError("stage2.shoot.lr and .periods must be positive")
        if self.anchor < 0:
            raise ValueError(f"stage2.shoot.anchor={self.anchor} must be 0 (none) or a positive price")


@dataclass
class Stage2Config:
    """Everything that decides the outcome of stage 2, less the chart and the seed."""

    form: FormConfig
    floor: FloorConfig
    start: StartConfig
    stride_frames: int  # between the four samples of a one-step window
    longest_step: float  # of the integrator, in time units; frames further apart take several steps
    ridge: float  # rho: caps the ratio of weights between two latent directions at 1 / rho
    velocity_weight: float  # of the velocity term against the position term
    effort: float  # share of all steps below that is taken: a profile's, where the others are a system's
    steps: int  # of the one-step objective
    batch: int  # windows a step
    lr: float  # Adam
    final_fraction: float  # of the rate, reached at the last step on a cosine; 1 keeps it constant
    gradient_clip: float
    select: SelectConfig
    shoot: ShootConfig

    def __post_init__(self) -> None:
        if self.stride_frames < 1:
            raise ValueError(f"stage2.stride_frames={self.stride_frames} must be at least 1 frame")
        if not 0 < self.effort <= 1:
            raise ValueError(f"stage2.effort={self.effort} is a share of the steps: choose it in (0, 1]")
        if self.longest_step <= 0:
            raise ValueError(f"stage2.longest_step={self.longest_step} must be a positive time")
        if self.ridge <= 0:
            raise ValueError(
                f"stage2.ridge={self.ridge} must be positive: a direction nothing can see "
                "would be left unconstrained"
            )
        if self.steps < 0 or self.batch < 1:
            raise ValueError(
                f"stage2.steps={self.steps} must be 0 or more and stage2.batch={self.batch} at least 1"
            )
        if min(self.lr, self.gradient_clip) <= 0 or self.velocity_weight < 0:
            raise ValueError("stage2.lr and .gradient_clip must be positive, .velocity_weight not negative")
        if not 0 < self.final_fraction <= 1:
            raise ValueError(f"stage2.final_fraction={self.final_fraction} must lie in (0, 1]")
