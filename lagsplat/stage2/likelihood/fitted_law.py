"""A law of polynomials as it stands in a fit, the same law of other degrees, and its scales of time."""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.config import Degrees
from lagsplat.stage2.equilibrium import NoEquilibriumError, linearize_modes
from lagsplat.stage2.lagrangian import Coefficients, Lagrangian
from lagsplat.stage2.likelihood.multiple_shooting import MultipleShooting
from lagsplat.stage2.likelihood.parameter_vector import FRAME, MAP, POTENTIAL, VOLUMES, ParameterVector
from lagsplat.stage2.likelihood.prior import ABSENT
from lagsplat.stage2.likelihood.window_likelihood import WindowFit
from lagsplat.stage2.validation import ForecastErrors

# The numbers below were set by hand, with both simulated arms, the rocker and the chair in view.
FIRST_COUPLING = 0.1  # of the windows, relative to the rms of the states
LEAST_NOISE = 1e-4  # of encoded positions [whitened units]
LARGEST_STEP = 1.2  # times the fastest eigenvalue of a Runge-Kutta step: its error is 2 %, and it is stable
ACCURATE_STEP = 0.6  # times the slowest one: 0.1 %
MOST_PIECES = 4  # of a frame


@dataclass(frozen=True)
class FittedLaw:
    """A law, how well it forecasts and explains the recording, under which noise and coupling."""

    law: Lagrangian
    errors: ForecastErrors  # over the training clip
    period_frames: int  # of its slowest oscillation
    noise: Float64[np.ndarray, " d"]  # of encoded positions [whitened units]
    memory: Float64[np.ndarray, " d"]  # its correlation from frame to frame
    coupling: float = FIRST_COUPLING
    evidence: float = -math.inf  # [nat]
    relevance: Float64[np.ndarray, " g"] | None = None  # of the priors of terms that a linear law has not
    solved: tuple[MultipleShooting, WindowFit] | None = None  # None: its windows are not fitted
    half_width: int | None = None  # of the bumps [frames], if it is a law of the weak form

    def with_fitted_noise(self) -> "FittedLaw":
        """Take what the law leaves of the encoded positions for their noise, under which evidence is open."""
        if self.solved is None:
            return self
        fitted = self.solved[1]
        noise = np.maximum(fitted.rms, LEAST_NOISE)
        return replace(self, noise=noise, memory=fitted.memory, evidence=-math.inf)


def set_time_scales(law: Lagrangian, trajectory: EncodedTrajectory, *, period_frames: int) -> int:
    """Let the fastest mode decide how many steps divide a frame; frames of the slowest period.

    They are ``period_frames`` for a law that does not oscillate. One without an equilibrium, which no fit
    ends with, takes the shortest steps.
    """
    dt_s = trajectory.dt_s
    try:
        modes = linearize_modes(law, torch.from_numpy(trajectory.inputs.mean(0)))
    except NoEquilibriumError:
        law.longest_step = dt_s / float(law.time_unit_s) / MOST_PIECES
        return period_frames
    sizes = np.hypot(2.0 * np.pi * np.array(modes.frequency_hz), modes.decay_per_s) * dt_s
    pieces = math.ceil(max(sizes.max() / LARGEST_STEP, sizes.min() / ACCURATE_STEP))
    law.longest_step = dt_s / float(law.time_unit_s) / int(np.clip(pieces, 1, MOST_PIECES))
    oscillating = [f for f in modes.frequency_hz if f > 0]
    return max(4, round(1.0 / (min(oscillating) * dt_s))) if oscillating else period_frames


def is_mechanism(law: Lagrangian) -> bool:
    """Whether its coordinates are one to one and a stable spring holds it far outside the data."""
    assert law.coordinates is not None
    assert law.energy is not None
    return law.coordinates.measure_least_stretch() > 0.0 and law.energy.measure_far_stiffness() > 0.0


def change_degrees(law: Lagrangian, degrees: Degrees, *, seed: int) -> Lagrangian:
    """Make a polynomial law of other degrees: the same function as ``law``, less the terms that it lacks."""
    eye = torch.eye(law.d, dtype=torch.float64)
    grown = Lagrangian(
        Coefficients(eye, eye, eye, eye.new_zeros(law.n_inputs, law.d), eye.new_zeros(law.d)),
        form=law.form.with_degrees(degrees),
        floors=law.floors,
        time_unit_s=float(law.time_unit_s),
        seed=seed,
        longest_step=law.longest_step,
    )
    state = grown.state_dict()
    for name, values in law.state_dict().items():
        # polynomials are in the order of degrees
        if name.startswith("energy.") and name.endswith("coefficients"):
            n = min(values.shape[-1], state[name].shape[-1])
            state[name].zero_()[..., :n] = values[..., :n]
        elif name.endswith(("frame.coefficients", "coordinates.coefficients")):
            n = min(len(values), len(state[name]))
            state[name].zero_()[:n] = values[:n]
        else:
            state[name] = values
    grown.load_state_dict(state)
    return grown


def drop_absent_terms(fitted: FittedLaw, *, seed: int) -> FittedLaw:
    """The same law without the terms that the evidence has taken out."""
    assert fitted.relevance is not None
    groups = ParameterVector(fitted.law).list_groups()
    absent = {name for name, each in zip(groups, fitted.relevance, strict=True) if each == ABSENT}
    now = fitted.law.form.degrees
    degrees = Degrees(
        potential=2 if POTENTIAL in absent else now.potential,
        inputs=1 if VOLUMES in absent else now.inputs,
        coordinates=1 if MAP in absent else now.coordinates,
        matrices=0 if FRAME in absent else now.matrices,
    )
    relevance = fitted.relevance[fitted.relevance != ABSENT]
    return replace(fitted, law=change_degrees(fitted.law, degrees, seed=seed), relevance=relevance)
