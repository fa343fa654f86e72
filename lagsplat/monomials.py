"""Monomials of a state that is clipped softly outside the data, with their derivatives.

Inside a ball around the data the clipped state ``s`` is the state ``q``; outside it is bounded, and so are
monomials and their slopes. A clip that began inside the data would bend a line: with ``s = 4 tanh(q / 4)`` a
quartic of a linear spring is 1 to 2 % too stiff at rest. A box would leave polynomials free in its corners,
twice as far from its center as any state in four coordinates.
"""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.array_types import Latents
from lagsplat.integer_lists import list_powers

# The numbers below were set by hand, with both simulated arms and the toy in view.
ROOM = 0.25  # of the radius of the ball, by which the clipped state leaves it at most
OUTSIDE = 1e-3  # share of the states outside the ball: outliers of the encoder

Ball = Float[Tensor, " d1"]
"""Center of the ball in which the clipped state is the state, and its radius, which is last."""

Monomials = tuple[Float[Tensor, "B k"], Float[Tensor, "B k d"]]
"""Values and gradients of monomials at ``B`` states."""


def enclose_states(q: Latents) -> Ball:
    """The ball around the mean of some states that leaves out one in a thousand."""
    center = q.mean(0)
    return torch.cat([center, (q - center).norm(dim=1).quantile(1.0 - OUTSIDE)[None]])


def make_wide_ball(d: int, radius: float = 1e99) -> Ball:
    """A ball around zero, by default so wide that nothing is clipped."""
    return torch.cat([torch.zeros(d, dtype=torch.float64), torch.tensor([radius], dtype=torch.float64)])


def draw_states(ball: Ball, n: int, *, reach: float, seed: int) -> Latents:
    """Draw states at random, in all directions and uniformly up to ``reach`` times the radius of a ball."""
    generator = torch.Generator().manual_seed(seed)
    side = torch.randn(n, len(ball) - 1, generator=generator, dtype=torch.float64)
    r = reach * ball[-1] * torch.rand(n, 1, generator=generator, dtype=torch.float64)
    return ball[:-1] + r * side / side.norm(dim=1, keepdim=True)


def list_exponents(d: int, *, lowest: int, highest: int) -> Float[Tensor, "k d"]:
    """Exponents of all monomials of ``d`` variables of the degrees ``lowest`` to ``highest``, by degree."""
    return torch.from_numpy(list_powers(d, lowest=lowest, highest=highest)).double()


class SoftClip:
    """The state ``s = c + a(r) (q - c)``, ``r = |q - c|``, that is ``q`` in a ball and bounded outside.

    Outside, ``r a(r) = R (1 + ROOM tanh((r - R) / (ROOM R)))``; two derivatives are continuous.

    Args:
        q: states [whitened units].
        ball: its center ``c`` and radius ``R``.
    """

    def __init__(self, q: Latents, ball: Ball) -> None:
        center, radius = ball[:-1], ball[-1]
        self.z, self.s = q - center, q
        norm = self.z.norm(dim=1, keepdim=True)
        self.all_inside = not bool((norm > radius).any())
        if self.all_inside:
            return
        r = norm.clamp(min=radius)  # whereby all below is the identity's inside
        tanh = torch.tanh((r - radius) / (ROOM * radius))
        self.slope = 1.0 - tanh * tanh  # of r a(r)
        self.bend = -2.0 / (ROOM * radius) * tanh * self.slope
        self.share = radius * (1.0 + ROOM * tanh) / r  # a
        first = (self.slope - self.share) / r  # da/dr, and the second derivative
        second = (self.bend - 2.0 * first) / r
        self.r, self.first = r, first
        self.turned = first / r
        self.curved = (second - self.turned) / r**2
        self.s = center + self.share * self.z

    def pull_back(self, slopes: Float[Tensor, "B k d"]) -> Float[Tensor, "B k d"]:
        """Slopes by ``q`` of functions whose ``slopes`` by ``s`` are known."""
        if self.all_inside:
            return slopes
        along = slopes @ self.z[:, :, None]
        return self.share[:, None] * slopes + self.turned[:, None] * along * self.z[:, None]

    def pull_back_bends(
        self, slopes: Float[Tensor, "B k d"], bends: Float[Tensor, "B k d d"]
    ) -> Float[Tensor, "B k d d"]:
        """Second derivatives by ``q`` of functions whose derivatives by ``s`` are known."""
        if self.all_inside:
            return bends
        z, d = self.z, self.z.shape[1]
        eye = torch.eye(d, dtype=z.dtype)
        jacobian = self.share[:, :, None] * eye + self.turned[:, :, None] * z[:, :, None] * z[:, None]
        along = (slopes @ z[:, :, None])[..., None]
        spread = slopes[..., None] * z[:, None, None]
        turned, curved = (part[:, :, None, None] for part in (self.turned, self.curved))
        own = turned * (spread + spread.mT + along * eye)
        own = own + curved * along * (z[:, :, None] * z[:, None])[:, None]
        return jacobian[:, None] @ bends @ jacobian[:, None] + own


def evaluate_monomials(
    q: Latents, exponents: Float[Tensor, "k d"], *, ball: Ball, free_degree: int = 0
) -> Monomials:
    """Values and gradients at ``q`` of monomials of the state ``s`` that is clipped softly (`SoftClip`).

    Args:
        q: states [whitened units].
        exponents: powers of each coordinate, one row a monomial, from `list_exponents`.
        ball: where ``s = q`` [whitened units].
        free_degree: up to which monomials are of the state itself.

    Example:
        >>> import torch
        >>> from lagsplat.monomials import evaluate_monomials, list_exponents
        >>> exponents = list_exponents(1, lowest=1, highest=2)
        >>> ball = torch.tensor([0.0, 9.0]).double()
        >>> value, slope = evaluate_monomials(torch.tensor([[0.1]]).double(), exponents, ball=ball)
        >>> [round(float(x), 4) for x in (*value[0], *slope[0, :, 0])]
        [0.1, 0.01, 1.0, 0.2]
    """
    clip = SoftClip(q, ball)
    if not clip.all_inside and (free := exponents.sum(1) <= free_degree).any():
        near = evaluate_monomials(q, exponents[free], ball=make_wide_ball(q.shape[1]))
        beyond = evaluate_monomials(q, exponents[~free], ball=ball)
        return torch.cat([near[0], beyond[0]], 1), torch.cat([near[1], beyond[1]], 1)
    levels, order, d = _raise_powers(clip.s, exponents), exponents.long(), q.shape[1]
    factors = [levels[order[:, i], i] for i in range(d)]
    value = torch.ones((len(exponents), len(q)), dtype=q.dtype)
    for factor in factors:
        value = value * factor
    slopes = []
    for i in range(d):
        slope = exponents[:, i, None] * levels[(order[:, i] - 1).clamp(min=0), i]
        for j in range(d):
            if j != i:
                slope = slope * factors[j]
        slopes.append(slope)
    return value.T, clip.pull_back(torch.stack(slopes, 2).permute(1, 0, 2))


def differentiate_monomials(
    q: Latents, exponents: Float[Tensor, "k d"], *, ball: Ball, free_degree: int = 0
) -> tuple[Float[Tensor, "B k"], Float[Tensor, "B k d"], Float[Tensor, "B k d d"]]:
    """Values, gradients and second derivatives of `evaluate_monomials`."""
    clip = SoftClip(q, ball)
    if not clip.all_inside and (free := exponents.sum(1) <= free_degree).any():
        near = differentiate_monomials(q, exponents[free], ball=make_wide_ball(q.shape[1]))
        beyond = differentiate_monomials(q, exponents[~free], ball=ball)
        value, slope, bends = (torch.cat(pair, 1) for pair in zip(near, beyond, strict=True))
        return value, slope, bends
    levels, order, d = _raise_powers(clip.s, exponents), exponents.long(), q.shape[1]
    rows = []  # value, first and second derivative of the power of each coordinate
    for i in range(d):
        power = exponents[:, i, None]
        lower, lowest = (levels[(order[:, i] - n).clamp(min=0), i] for n in (1, 2))
        rows.append((levels[order[:, i], i], power * lower, power * (power - 1.0) * lowest))
    one = torch.ones((len(exponents), len(q)), dtype=q.dtype)

    def multiply(orders: Sequence[int]) -> Float[Tensor, "k B"]:
        product = one
        for row, derivative in zip(rows, orders, strict=True):
            product = product * row[derivative]
        return product

    at = range(d)
    value = multiply([0] * d)
    slope = torch.stack([multiply([int(i == m) for m in at]) for i in at], 2).permute(1, 0, 2)
    bend = [multiply([int(i == m) + int(j == m) for m in at]) for i in at for j in at]
    bends = torch.stack(bend, 2).reshape(len(exponents), len(q), d, d).permute(1, 0, 2, 3)
    return value.T, clip.pull_back(slope), clip.pull_back_bends(slope, bends)


def _raise_powers(s: Latents, exponents: Float[Tensor, "k d"]) -> Float[Tensor, "n d B"]:
    """Powers of the clipped state, from the zeroth on."""
    powers = [torch.ones_like(s.T)]
    for _ in range(int(exponents.max()) if exponents.numel() else 0):
        powers.append(powers[-1] * s.T)
    return torch.stack(powers)
