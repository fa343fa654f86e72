"""Networks under the likelihood: they take over the most likely polynomial law and are fitted as it was.

A network has too many weights for Gauss-Newton steps and too many minima for a poor start. So it first learns
the accelerations of a polynomial law of maximum likelihood, without noise and in seconds. Then the same
windows, noise and coupling decide, by quasi-Newton steps of all weights and window starts.
"""

from collections.abc import Callable, Iterable

import numpy as np
import torch
from jaxtyping import Float, Float64
from scipy.optimize import minimize
from torch import Tensor
from torch.autograd.functional import jacobian

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.equilibrium import find_equilibrium
from lagsplat.stage2.input_stiffness import InputStiffness, measure_input_range
from lagsplat.stage2.lagrangian import Coefficients, Lagrangian
from lagsplat.stage2.likelihood.parameter_vector import Paths, States
from lagsplat.stage2.likelihood.prior import Prior
from lagsplat.stage2.likelihood.window_likelihood import WindowFit, WindowLikelihood
from lagsplat.stage2.likelihood.windows import Windows
from lagsplat.stage2.rollout import advance_under

SAMPLES = 2048  # states at which laws are compared
PROJECTION_STEPS = 6  # of which each is far cheaper, for one of the likelihood; set by hand
UNUSABLE = 1e6  # objective of weights whose rollouts overflow, as a multiple of the first objective


class NetworkVector:
    """The weights of a law of networks as one vector, and rollouts whose derivatives torch computes."""

    def __init__(self, lagrangian: Lagrangian) -> None:
        self.lagrangian = lagrangian
        self.parts = {name: p for name, p in lagrangian.named_parameters() if p.requires_grad}

    def join(self) -> Float[Tensor, " p"]:
        """The weights as they are, with their gradients."""
        return _join(self.parts.values())

    def read(self) -> Float[Tensor, " p"]:
        """The weights as they are."""
        return self.join().detach()

    def write(self, theta: Float[Tensor, " p"]) -> None:
        """Set the weights of the law."""
        torch.nn.utils.vector_to_parameters(theta, self.parts.values())

    def list_bounds(self) -> list[tuple[float | None, float | None]]:
        """Bounds of the weights: heads of convex networks are not negative."""
        nets = {"convex": self.lagrangian.convex, "volume_net": self.lagrangian.volume_net}
        heads = {f"{name}.head" for name, net in nets.items() if net is not None}
        return [
            (0.0, None) if name in heads else (None, None)
            for name, p in self.parts.items()
            for _ in range(p.numel())
        ]

    def roll_out(self, theta: Float[Tensor, " p"], starts: States, windows: Windows) -> Paths:
        """States of all windows, the start included; leaves the law at ``theta``."""
        self.write(theta)
        ready = self.lagrangian.prepare()
        q, v = starts.chunk(2, 1)
        path = [starts]
        for i in range(windows.n):
            step = windows.steps[:, i, None]
            q, v = advance_under(self.lagrangian, q, v, windows.inputs[:, i], step=step, ready=ready)
            path.append(torch.cat([q, v], 1))
        return torch.stack(path, 1)

    def observe(
        self, theta: Float[Tensor, " p"], x: Float[Tensor, "K n d"], near: Float[Tensor, "K n d"]
    ) -> Float[Tensor, "K n d"]:
        """Latents at positions of the law, which are its coordinates."""
        return x


def linearize_law(law: Lagrangian, inputs: Float64[np.ndarray, "T n_u"]) -> Coefficients:
    """Constant matrices of a law near its equilibrium under the mean input, with a mass of mean eigenvalue 1.

    Second derivatives of the volumes are the stiffness of the inputs. The rest state is where the linearised
    elastic force vanishes.

    Raises:
        NoEquilibriumError: none was found under the mean input.
    """
    mean = torch.from_numpy(inputs.mean(axis=0))
    q, ready = find_equilibrium(law, mean), law.prepare()
    none, units = torch.zeros_like(mean), torch.eye(len(mean), dtype=torch.float64)

    def differentiate(u: Tensor) -> tuple[Tensor, Tensor]:
        """Slope and curvature of the energy under an input."""

        def slope(x: Tensor) -> Tensor:
            return -law.conservative_force(x[None], u[None], ready)[0]

        return slope(q).detach(), jacobian(slope, q)

    with torch.no_grad():
        mass, damping = law.mass(q[None])[0], law.damping(q[None])[0]
    scale = law.d / torch.trace(mass)
    elastic, stiffness = differentiate(none)
    stiffness = _clip_eigenvalues(stiffness, 1e-3 / float(scale))
    rest = q - torch.linalg.solve(stiffness, elastic)
    loaded = [differentiate(unit) for unit in units]
    pull = torch.stack([elastic - slope for slope, _ in loaded] or [none.new_zeros(law.d)])[: len(mean)]
    bend = torch.stack([curved - stiffness for _, curved in loaded] or [stiffness])[: len(mean)]
    bend = 0.5 * (bend + bend.mT)
    stiffer, softer = (scale * _clip_eigenvalues(part, 0.0) for part in (bend, -bend))
    return Coefficients(
        mass=scale * mass,
        damping=scale * damping,
        stiffness=scale * stiffness,
        pressure_map=scale * (pull + bend @ (q - rest)),
        rest=rest,
        input_stiffness=InputStiffness(stiffer, softer, measure_input_range(inputs)) if len(mean) else None,
    )


def _clip_eigenvalues(matrix: Float[Tensor, "*c d d"], least: float) -> Float[Tensor, "*c d d"]:
    values, vectors = torch.linalg.eigh(0.5 * (matrix + matrix.mT))
    return (vectors * values.clamp(min=least)[..., None, :]) @ vectors.mT


def project_law(
    law: Lagrangian, onto: Lagrangian, smooth: EncodedTrajectory, *, iterations: int, seed: int
) -> float:
    """Move the weights of ``onto`` until its accelerations are those of ``law``; return what is left.

    Laws are compared at states of the recording, and at positions, velocities and inputs of three different
    frames. Polynomials beyond the data would keep networks from following them inside. An error of the
    acceleration counts as the displacement that it causes within a time unit, since fast modes have large
    accelerations and hardly move.

    Args:
        law: a fitted law.
        onto: a law of networks with the same unit of time, changed in place.
        smooth: the smoothed training trajectory.
        iterations: quasi-Newton steps at most of the likelihood; there are `PROJECTION_STEPS` times as many.
        seed: of the states.

    Returns:
        The rms of the remaining displacement, relative to that which the accelerations cause.
    """
    rng, unit = np.random.default_rng(seed), float(law.time_unit_s)
    series = (smooth.latents, unit * smooth.differentiate(1), smooth.inputs)
    picked = rng.integers(len(smooth.latents), size=(4, SAMPLES // 2))
    samples = []
    for values, own in zip(series, picked[1:], strict=True):
        samples.append(np.concatenate([values[picked[0]], values[own]]))
    q, v, u = map(torch.from_numpy, samples)
    near = linearize_law(law, smooth.inputs)
    weight = torch.linalg.solve(near.mass + near.stiffness, near.mass)
    with torch.no_grad():
        wanted = law.acceleration(q, v, u) @ weight.T
    size = wanted.square().sum()
    vector = NetworkVector(onto)

    def measure() -> Tensor:
        return (onto.acceleration(q, v, u) @ weight.T - wanted).square().sum() / size

    return float(np.sqrt(_minimize(measure, vector, iterations=PROJECTION_STEPS * iterations)))


def fit_networks(
    networks: Lagrangian, law: Lagrangian, solved: tuple[WindowLikelihood, WindowFit], *, iterations: int
) -> WindowFit:
    """Maximise the likelihood over the weights of networks, in place, and over the window starts.

    The prior of the weights is normal, about what they are at first and of unit size.

    Args:
        networks: they have learned the law, see `project_law`.
        law: a fitted polynomial law.
        solved: its windows, with their noise and coupling, and the states at their starts.
        iterations: quasi-Newton steps at most.
    """
    fitted_law, fitted = solved
    vector, d, coordinates = NetworkVector(networks), law.d, law.coordinates
    first = vector.read()
    assert coordinates is not None
    with torch.no_grad():
        starts = torch.cat(coordinates.pull(*fitted.starts.split(d, 1)), 1)
    spread = starts.std(0) / fitted.starts.std(0)  # of a single window there is no gap
    problem = WindowLikelihood(
        vector,
        fitted_law.windows,
        noise=fitted_law.noise.numpy(),
        memory=fitted_law.memory.numpy(),
        coupling=(fitted_law.coupling * spread.nan_to_num(nan=1.0)).numpy(),
        prior=Prior(first.numpy(), np.ones(len(first)), [], np.zeros(0)),
    )
    free = starts.clone().requires_grad_()

    def measure() -> Tensor:
        now = problem.evaluate(vector.read(), free)
        moved = vector.join() - first
        return 0.5 * (now.position.square().sum() + now.gap.square().sum() + moved.square().sum())

    _minimize(measure, vector, free, iterations=iterations)
    with torch.no_grad():
        return problem.describe(problem.evaluate(vector.read(), free), free.detach(), steps=iterations)


def _join(parts: Iterable[Tensor]) -> Float[Tensor, " n"]:
    return torch.cat([part.reshape(-1) for part in parts])


def _minimize(measure: Callable[[], Tensor], vector: NetworkVector, *more: Tensor, iterations: int) -> float:
    """Minimise by L-BFGS-B over the weights and ``more``, which are left at the best; return the value."""
    parts = [*vector.parts.values(), *more]
    bounds = [*vector.list_bounds(), *[(None, None)] * sum(each.numel() for each in more)]
    scale = 1.0

    def write(flat: np.ndarray) -> None:
        torch.nn.utils.vector_to_parameters(torch.from_numpy(flat.copy()), parts)

    def evaluate(flat: np.ndarray) -> tuple[float, np.ndarray]:
        write(flat)
        value = measure()
        slopes = torch.autograd.grad(value, parts, allow_unused=True)
        slope = _join(0.0 * p if g is None else g for p, g in zip(parts, slopes, strict=True))
        if not (torch.isfinite(value) and torch.isfinite(slope).all()):
            return UNUSABLE, np.zeros_like(flat)
        return float(value.detach()) / scale, slope.detach().numpy() / scale

    first = _join(parts).detach().numpy()
    scale = max(evaluate(first)[0], 1e-300)
    options = {"maxiter": iterations, "maxfun": 2 * iterations, "maxcor": 30, "ftol": 1e-9, "gtol": 1e-9}
    best = minimize(evaluate, first, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    write(best.x)
    return float(best.fun) * scale
