"""The latent Lagrangian: mass, damping, potential and actuation, and its acceleration."""

import copy
import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lagsplat.array_types import Inputs, Latents, Spd
from lagsplat.monomials import Ball, enclose_states, make_wide_ball
from lagsplat.stage2.config import FormConfig
from lagsplat.stage2.decoder_mass import DecoderGeometry, InducedMass
from lagsplat.stage2.input_stiffness import InputStiffness, InputStiffnessPrior, stiffen
from lagsplat.stage2.networks import (
    Block,
    ConstantMatrix,
    Diffeomorphism,
    Icnn,
    MatrixField,
    factor_positive,
    pull_back,
    push_forward,
)
from lagsplat.stage2.polynomials import PolynomialEnergy, PolynomialField, PolynomialFrame, PolynomialMap

WIDE = 4.0  # radius of the ball of polynomials where no data are given [whitened units]


@dataclass(frozen=True)
class Coefficients:
    """Constant matrices of a mechanical system in internal time units.

    ``M a + C w + K (q - rest) = sum_c u_c (pressure_map_c - Q_c (q - rest))`` with ``Q_c`` the curvatures of
    ``input_stiffness``; without it the system is linear.
    """

    mass: Float[Tensor, "d d"]
    damping: Float[Tensor, "d d"]
    stiffness: Float[Tensor, "d d"]
    pressure_map: Float[Tensor, "n_u d"]
    rest: Float[Tensor, " d"]
    input_stiffness: InputStiffness | None = None


@dataclass(frozen=True)
class Floors:
    """Lower bounds of M, C and the curvature of V in the units of the starting matrices."""

    mass: float
    damping: float
    stiffness: float


@dataclass(frozen=True)
class PreparedCoefficients:
    """Terms that depend on the parameters alone, computed once per optimiser step."""

    blocks: list[Block]
    stiffness: Float[Tensor, "d d"]
    rest_image: Float[Tensor, "1 d"]
    rest_slope: Float[Tensor, "1 d"]
    between: Tensor | None
    between_volume: Tensor | None
    curvature: Float[Tensor, "n_u d d"] | None


class Lagrangian(nn.Module):
    """``L = v.M(q) v / 2 - V(q)`` with dissipation ``C(q)`` and chamber volumes ``nu(q)``.

    With ``x = Phi(q)`` (the identity unless the potential is invex) and ``x_r = Phi(q_r)``:
    ``V = Bregman_g(x, x_r) + (x - x_r).K (x - x_r) / 2`` and
    ``nu = B (x - x_r) - (x - x_r).Q (x - x_r) / 2 - N(x)``, where ``g`` and ``N`` are convex and ``Q`` is a
    `InputStiffnessPrior`. Because both share ``Phi``, the loaded potential ``V - u.nu`` is strongly convex in
    ``x`` for every ``u >= 0`` up to the largest input, and under any load where the volumes are concave.
    Hence there is one equilibrium. If inputs are ``signed`` (torques, currents), this holds from the largest
    negative to the largest positive input: negative inputs have a second convex network, weighted by their
    size, so that ``-u.nu`` stays convex.

    ``K``, ``M`` and ``C`` have floors, and every network starts at zero. The internal unit of time is
    ``time_unit_s`` seconds; a step of the integrator is at most ``longest_step`` of them.

    With ``form.terms='polynomial'`` potential and volumes are a `PolynomialEnergy` of the coordinates ``x
    = g(q)`` of a `PolynomialMap`, as are the mass and the damping. Energy still never rises and motion is
    bounded; equilibria are not one by construction, but counted (`list_stable_equilibria`).

    Args:
        start: constant matrices to start from.
        form: which terms depend on the state, and the sizes of their networks.
        floors: lower bounds of the matrices.
        time_unit_s: internal unit of time [s].
        seed: of the initial weights.
        geometry: geometry of the decoder, for an induced mass.
        mass_scale: factor on an induced mass.
        signed: whether inputs take negative values.
        longest_step: longest step of the integrator in internal time units.
        ball: around the training latents, in which polynomials are free.
        integrator: ``verlet``, under inputs held over a frame as published, or ``runge_kutta``, under inputs
            interpolated between frames, as always for polynomials.

    Source: paper eqs. (EL), (pressure) and Appendix, "Bounded forced response".

    Example:
        >>> import lagsplat, torch
        >>> lagrangian = lagsplat.open_run("run").lagrangian
        >>> lagrangian.potential(torch.zeros(1, lagrangian.d, dtype=torch.float64)).shape
        torch.Size([1])
    """

    time_unit_s: Tensor

    def __init__(
        self,
        start: Coefficients,
        *,
        form: FormConfig,
        floors: Floors,
        time_unit_s: float,
        seed: int,
        geometry: DecoderGeometry | None = None,
        mass_scale: float = 1.0,
        signed: bool = False,
        longest_step: float = math.inf,
        ball: Ball | None = None,
        integrator: str = "verlet",
    ) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(seed)
        d, n_inputs = start.rest.shape[0], start.pressure_map.shape[0]
        self.d, self.n_inputs, self.form, self.floors = d, n_inputs, form, floors
        self.longest_step = longest_step
        signed = signed or (start.input_stiffness is not None and start.input_stiffness.input_range.signed)
        self.signed = signed and form.actuation != "linear" and n_inputs > 0 and form.terms != "polynomial"
        self.register_buffer("time_unit_s", torch.tensor(time_unit_s, dtype=torch.float64))
        self.mass_term: MatrixField | ConstantMatrix | PolynomialField | InducedMass
        self.damping_term: MatrixField | ConstantMatrix | PolynomialField
        self.energy: PolynomialEnergy | None = None
        self.coordinates: PolynomialMap | None = None
        polynomial = form.terms == "polynomial"
        self.integrator = "runge_kutta" if polynomial else integrator
        if polynomial:
            ball = make_wide_ball(d, WIDE) if ball is None else ball
            self.coordinates = PolynomialMap(d, degree=form.degrees.coordinates, ball=ball)
            frame = PolynomialFrame(d, degree=form.degrees.matrices, ball=ball)
            self.mass_term = PolynomialField(start.mass, floor=floors.mass, frame=frame)
            self.damping_term = PolynomialField(start.damping, floor=floors.damping, frame=frame)
        elif form.mass != "induced":
            self.mass_term = _make_matrix(form, form.mass, start.mass, floors.mass, generator)
        elif geometry is not None:
            self.mass_term = InducedMass(geometry, scale=mass_scale, floor=floors.mass)
        else:
            raise ValueError(
                "stage2.form.mass='induced' needs the decoder's geometry; pass geometry=DecoderGeometry(...) "
                "or choose 'learned' or 'constant'"
            )
        if not polynomial:
            self.damping_term = _make_matrix(form, form.damping, start.damping, floors.damping, generator)
        self.curvature: InputStiffnessPrior | None = None
        stiffness = start.stiffness
        if start.input_stiffness is not None and form.actuation != "linear" and not polynomial:
            softening = form.actuation == "bounded"
            self.curvature = InputStiffnessPrior(start.input_stiffness, softening=softening)
            stiffness = stiffness - self.curvature.matrices()[1].detach()
        self.stiffness_factor = nn.Parameter(factor_positive(stiffness, floors.stiffness))
        self.pressure_map = nn.Parameter(start.pressure_map.clone())
        self.rest = nn.Parameter(start.rest.clone(), requires_grad=form.rest == "learned")
        self.diffeo: Diffeomorphism | None = None
        if form.potential == "invex" and not polynomial:
            size = (form.diffeo_blocks, form.diffeo_width)
            self.diffeo = Diffeomorphism(d, *size, lipschitz=form.diffeo_lipschitz, generator=generator)
        self.convex: Icnn | None = None
        if polynomial and ball is not None:
            self._make_energy(start, ball)
        elif form.potential != "quadratic":
            self.convex = Icnn(d, width=form.potential_width, heads=1, generator=generator)
        self.volume_net: Icnn | None = None
        if form.actuation != "linear" and n_inputs and not polynomial:
            heads = n_inputs * (1 + self.signed)
            self.volume_net = Icnn(d, width=form.actuation_width, heads=heads, generator=generator)

    def _make_energy(self, start: Coefficients, ball: Ball) -> None:
        """Make polynomials that begin as the quadratic potential and the linear volumes of ``start``."""
        self.energy = PolynomialEnergy(
            self.d,
            self.n_inputs,
            potential_degree=self.form.degrees.potential,
            input_degree=self.form.degrees.inputs,
            ball=ball,
        )
        self.energy.set_quadratic(start.stiffness, start.rest, start.pressure_map)
        for parameter in (self.stiffness_factor, self.pressure_map, self.rest):
            parameter.requires_grad_(False)  # `rest` follows from the polynomials

    def move_ball(self, latents: Latents) -> None:
        """Let the polynomials in the coordinates of the law be free where the map takes ``latents`` to."""
        energy, mass, _ = self.polynomials
        assert self.coordinates is not None
        with torch.no_grad():
            ball = enclose_states(self.coordinates.evaluate(latents)[0])
            energy.ball.copy_(ball)
            mass.frame.ball.copy_(ball)

    @property
    def polynomials(self) -> tuple[PolynomialEnergy, PolynomialField, PolynomialField]:
        """Energy, mass and damping of a polynomial law, in its coordinates.

        Raises:
            TypeError: the law has other terms.
        """
        energy, mass, damping = self.energy, self.mass_term, self.damping_term
        if (
            energy is None
            or not isinstance(mass, PolynomialField)
            or not isinstance(damping, PolynomialField)
        ):
            raise TypeError("the terms of the law are no polynomials")
        return energy, mass, damping

    def in_own_coordinates(self) -> "Lagrangian":
        """The law over ``x = g(q)``, where its terms are polynomials; itself if it is over latents."""
        if self.coordinates is None:
            return self
        law = copy.deepcopy(self)
        with torch.no_grad():
            law.rest.copy_(self.coordinates.evaluate(self.rest[None])[0][0])
        law.coordinates = PolynomialMap(self.d, degree=1, ball=self.coordinates.ball)
        return law

    def project(self) -> None:
        """Restore the sign constraints after an optimiser step."""
        for net in (self.convex, self.volume_net):
            if net is not None:
                net.project()

    def prepare(self) -> PreparedCoefficients:
        """Normalised weights and rest terms; valid until the parameters change."""
        blocks = self.diffeo.blocks() if self.diffeo is not None else []
        rest_image, _ = push_forward(self.rest[None], blocks)
        between, slope = None, torch.zeros_like(rest_image)
        if self.convex is not None:
            between = self.convex.between_weight()
            slope = self.convex.gradient(rest_image, self.convex.head, between)
        lower = torch.tril(self.stiffness_factor)
        stiffness = lower @ lower.T + self.floors.stiffness * torch.eye(self.d, dtype=lower.dtype)
        curvature = None
        if self.curvature is not None:
            curvature, compensation = self.curvature.matrices()
            stiffness = stiffness + compensation
        between_volume = None if self.volume_net is None else self.volume_net.between_weight()
        return PreparedCoefficients(blocks, stiffness, rest_image, slope, between, between_volume, curvature)

    def mass(self, q: Latents) -> Spd:
        """``M(q)``."""
        return self._pull_back_matrix(self.mass_term, q)

    def damping(self, q: Latents) -> Spd:
        """``C(q)`` per internal time unit."""
        return self._pull_back_matrix(self.damping_term, q)

    def _pull_back_matrix(
        self, term: MatrixField | ConstantMatrix | PolynomialField | InducedMass, q: Latents
    ) -> Spd:
        if self.coordinates is None:
            return term.matrix(q)
        x, jacobian = self.coordinates.evaluate(q)
        return jacobian.mT @ term.matrix(x) @ jacobian

    def potential(self, q: Latents) -> Float[Tensor, " B"]:
        """``V(q)``, zero at the rest state and, unless polynomial, positive elsewhere."""
        if self.energy is not None and self.coordinates is not None:
            value = self.energy.potential(self.coordinates.evaluate(torch.cat([q, self.rest[None]]))[0])
            return value[:-1] - value[-1]
        ready = self.prepare()
        image, _ = push_forward(q, ready.blocks)
        offset = image - ready.rest_image
        value = 0.5 * ((offset @ ready.stiffness) * offset).sum(1)
        if self.convex is None:
            return value
        rise = self.convex.value(image)[:, 0] - self.convex.value(ready.rest_image)[:, 0]
        return value + rise - (offset * ready.rest_slope).sum(1)

    def volume(self, q: Latents, u: Inputs | None = None) -> Inputs:
        """Volumes ``nu(q)``, one per chamber; those of signed inputs depend on their sign in ``u``.

        Without ``u`` all inputs count as positive.
        """
        if self.energy is not None and self.coordinates is not None:
            value = self.energy.volume(self.coordinates.evaluate(torch.cat([q, self.rest[None]]))[0])
            return value[:-1] - value[-1]
        ready = self.prepare()
        image, _ = push_forward(q, ready.blocks)
        offset = image - ready.rest_image
        value = offset @ self.pressure_map.T
        if ready.curvature is not None:
            value = value - 0.5 * torch.einsum("bi,cij,bj->bc", offset, ready.curvature, offset)
        if self.volume_net is None:
            return value
        net = self.volume_net.value(image)
        if self.signed:
            above, below = net.split(self.n_inputs, 1)
            net = above if u is None else torch.where(u < 0, -below, above)
        return value - net

    def conservative_force(self, q: Latents, u: Inputs, ready: PreparedCoefficients) -> Latents:
        """``-grad_q (V - u.nu)``: elastic force plus the generalised force of the inputs."""
        if self.energy is not None and self.coordinates is not None:
            x, jacobian = self.coordinates.evaluate(q)
            return -(self.energy.slope(x, u)[:, None] @ jacobian)[:, 0]
        image, hidden = push_forward(q, ready.blocks)
        offset = image - ready.rest_image
        slope = torch.addmm(-ready.rest_slope, offset, ready.stiffness)
        if self.n_inputs:
            slope = slope - u @ self.pressure_map
        if ready.curvature is not None:
            slope = slope + stiffen(u, ready.curvature, offset)
        if self.convex is not None and ready.between is not None:
            slope = slope + self.convex.gradient(image, self.convex.head, ready.between)
        if self.volume_net is not None and ready.between_volume is not None:
            if self.signed:
                u = torch.cat([u.clamp(min=0.0), (-u).clamp(min=0.0)], 1)
            slope = slope + self.volume_net.gradient(image, u @ self.volume_net.head, ready.between_volume)
        return -pull_back(slope, ready.blocks, hidden)

    def acceleration(
        self, q: Latents, v: Latents, u: Inputs, *, ready: PreparedCoefficients | None = None
    ) -> Latents:
        """Solve ``M a = grad T - grad V - (dM/dt) v - C v + grad (u.nu)`` in internal time units.

        A row that is not finite gives a row that is not finite and never raises. ``ready`` saves the call of
        `prepare` in a loop.
        """
        ready = ready or self.prepare()
        return self.accelerate(q, v, self.conservative_force(q, u, ready) - self.resist(q, v))

    def resist(self, q: Latents, v: Latents) -> Latents:
        """``C(q) v``."""
        if self.coordinates is None:
            return self.damping_term.product(q, v)
        x, jacobian = self.coordinates.evaluate(q)
        resisted = self.damping_term.product(x, (jacobian @ v[:, :, None])[:, :, 0])
        return (resisted[:, None] @ jacobian)[:, 0]

    def accelerate(self, q: Latents, v: Latents, force: Latents) -> Latents:
        """``M^-1 (force + grad T - (dM/dt) v)``."""
        if self.coordinates is None:
            return self.mass_term.accelerate(q, v, force)
        x, jacobian = self.coordinates.evaluate(q)
        w = (jacobian @ v[:, :, None])[:, :, 0]
        pulled = torch.linalg.solve_ex(jacobian.mT, force[:, :, None])[0][:, :, 0]
        a = self.mass_term.accelerate(x, w, pulled) - self.coordinates.measure_bending(q, v)
        return torch.linalg.solve_ex(jacobian, a[:, :, None])[0][:, :, 0]


def _make_matrix(
    form: FormConfig, kind: str, start: Tensor, floor: float, generator: torch.Generator
) -> MatrixField | ConstantMatrix:
    if kind == "constant":
        return ConstantMatrix(start, floor=floor)
    return MatrixField(start, floor=floor, width=form.matrix_width, generator=generator)


@dataclass(frozen=True)
class LawEdits:
    """Factors on ``C``, ``M`` and ``V``; 1 keeps a term as learned.

    Raises:
        ValueError: a factor is not positive and finite; damping may be zero.

    Source: paper, "Interactive loop".
    """

    damping: float = 1.0
    inertia: float = 1.0
    stiffness: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (math.isfinite(value) and (value > 0.0 or (name == "damping" and value == 0.0))):
                raise ValueError(
                    f"edit {name}={value}: must be a positive number (damping may be 0); the law would not "
                    "come to rest, or not move at all"
                )


UNTOUCHED = LawEdits()
