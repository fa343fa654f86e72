"""The motion of one body with the state: rigid, or a smooth field that bends.

Poses are polynomials of the state, so that ways are arcs and not straight lines.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.array_types import Latents
from lagsplat.monomials import Ball, evaluate_monomials, list_exponents, make_wide_ball

Points = Float[Tensor, "P n"]
"""Places in the image or in space at the reference state, where all latents are zero [px]."""


@dataclass(frozen=True)
class BodyMotion:
    """Where the points of a body are at other states, from where they are at the reference state.

    With ``r = (x - center) / size`` a point moves from ``x`` to ``x + size A(q) b(r)``. A rigid body
    (``bending`` 0) has ``b = (r, 1)`` and ``A = (R(w) - I, t)``; of one that bends, ``b`` are the monomials
    of ``r`` of the degrees 0 to ``bending`` and ``A`` is free. The pose, ``(t, w)`` or ``A``, is
    ``coefficients`` (k, p) times the monomials of the state of the degrees 1 to ``latent_degree``, which
    outside ``ball`` are of the clipped state but for the linear ones. The covariance of the coefficients is
    the sum of outer products of the ``deviations``; without one it is not known.
    """

    center: Float[Tensor, " n"]  # [px]
    size: float  # [px]
    bending: int
    latent_degree: int
    ball: Ball
    coefficients: Float[Tensor, "k p"]
    deviations: tuple[Float[Tensor, "k p"], ...] = ()

    @property
    def d(self) -> int:
        """Latent dimension."""
        return len(self.ball) - 1

    @property
    def space(self) -> int:
        """Number of spatial dimensions."""
        return len(self.center)

    @property
    def n_pose(self) -> int:
        """Number of parameters ``p`` of a pose."""
        return self.coefficients.shape[1]

    def poses(self, q: Latents) -> tuple[Float[Tensor, "B p"], Float[Tensor, "B p d"]]:
        """Poses at states, and their derivatives by the state."""
        value, slope = self.evaluate_latent_monomials(q)
        return value @ self.coefficients, torch.einsum("bkd,kp->bpd", slope, self.coefficients)

    def evaluate_latent_monomials(self, q: Latents) -> tuple[Float[Tensor, "B k"], Float[Tensor, "B k d"]]:
        """Values and gradients of the monomials of the state."""
        exponents = list_exponents(self.d, lowest=1, highest=self.latent_degree)
        return evaluate_monomials(q, exponents, ball=self.ball, free_degree=1)

    def evaluate_basis(self, points: Points) -> Float[Tensor, "P m"]:
        """What ``A`` multiplies at each point; that of a weighted mean of points is the mean of theirs."""
        relative = (points - self.center) / self.size
        if not self.bending:
            return torch.cat([relative, torch.ones_like(relative[:, :1])], 1)
        exponents = list_exponents(self.space, lowest=0, highest=self.bending)
        return evaluate_monomials(relative, exponents, ball=make_wide_ball(self.space))[0]

    def folds(self, points: Points, q: Latents) -> bool:
        """Whether the body turns itself inside out at some of these points in some of these states.

        The determinant of its deformation gradient ``I + A(q) db/dr`` is positive wherever matter does not
        pass through itself.

        Source: Ogden, Non-linear Elastic Deformations (1984), section 2.1.
        """
        if not self.bending:
            return False
        exponents = list_exponents(self.space, lowest=0, highest=self.bending)
        relative = (points - self.center) / self.size
        slope = evaluate_monomials(relative, exponents, ball=make_wide_ball(self.space))[1]
        strain = torch.einsum("bim,pmj->bpij", self._assemble(self.poses(q)[0]), slope)
        gradient = torch.eye(self.space, dtype=points.dtype) + strain
        return bool((torch.linalg.det(gradient) <= 0.0).any())

    def displace(self, q: Latents) -> Float[Tensor, "B n m"]:
        """``size A(q)``, which turns the basis of a point into its way from the reference state [px]."""
        return self.size * self._assemble(self.poses(q)[0])

    def differentiate(self, q: Latents) -> Float[Tensor, "B n m d"]:
        """Derivatives of `displace` by the state."""
        pose, slope = self.poses(q)
        if self.bending:
            return self.size * slope.unflatten(1, (self.space, -1))
        n = self.space
        eye = torch.eye(n, dtype=pose.dtype)
        turned = torch.einsum("bjna,bad->bnjd", _differentiate_rotation(pose[:, n:], eye), slope[:, n:])
        return self.size * torch.cat([turned, slope[:, :n, None]], 2)

    def carry(self, points: Points, q: Latents) -> Float[Tensor, "B P n"]:
        """Places of points at states [px]."""
        return points + self.evaluate_basis(points) @ self.displace(q).mT

    def differentiate_by_pose(
        self, points: Points, q: Latents
    ) -> tuple[Float[Tensor, "B P n"], Float[Tensor, "B P n p"]]:
        """Places of points at states, and their derivatives by the parameters of the pose [px]."""
        basis, pose = self.evaluate_basis(points), self.poses(q)[0]
        place = points + self.size * basis @ self._assemble(pose).mT
        n, shape = self.space, (*place.shape, self.n_pose)
        if self.bending:
            slope = self.size * torch.einsum("pm,ij->pijm", basis, torch.eye(n, dtype=points.dtype))
            return place, slope.reshape(1, len(points), n, -1).expand(shape)
        slope = place.new_zeros(shape)
        slope[..., :n] = self.size * torch.eye(n, dtype=points.dtype)
        slope[..., n:] = self.size * _differentiate_rotation(pose[:, n:], basis[:, :n])
        return place, slope

    def jacobian(self, points: Points, q: Latents) -> Float[Tensor, "B P n d"]:
        """Motion of points per whitened unit at states [px]."""
        return torch.einsum("bnmd,pm->bpnd", self.differentiate(q), self.evaluate_basis(points))

    def with_latent_degree(self, degree: int) -> "BodyMotion":
        """The same motion, with polynomials of another degree of the state."""
        rows = math.comb(self.d + degree, degree) - 1
        coefficients = self.coefficients.new_zeros(rows, self.n_pose)
        kept = min(rows, len(self.coefficients))  # monomials are in the order of degrees
        coefficients[:kept] = self.coefficients[:kept]
        return replace(self, latent_degree=degree, coefficients=coefficients)

    def _assemble(self, pose: Float[Tensor, "B p"]) -> Float[Tensor, "B n m"]:
        n = self.space
        if self.bending:
            return pose.unflatten(1, (n, -1))
        turn = torch.linalg.matrix_exp(_make_skew(pose[:, n:])) - torch.eye(n, dtype=pose.dtype)
        return torch.cat([turn, pose[:, :n, None]], 2)


def list_deviated(bodies: Sequence[BodyMotion]) -> list[tuple[BodyMotion, ...]]:
    """The same bodies, with each deviation of one of them added to its coefficients."""
    return [
        (*bodies[:i], replace(body, coefficients=body.coefficients + each), *bodies[i + 1 :])
        for i, body in enumerate(bodies)
        for each in body.deviations
    ]


def make_body_at_rest(points: Points, ball: Ball, *, bending: int) -> BodyMotion:
    """A body around some points whose motion is still zero, linear in the state."""
    n, center = points.shape[1], points.mean(0)
    size = float((points - center).square().sum(1).mean().sqrt())
    n_pose = n * math.comb(n + bending, n) if bending else n * (n + 1) // 2
    still = torch.zeros(len(ball) - 1, n_pose, dtype=points.dtype)
    return BodyMotion(center, max(size, 1.0), bending, 1, ball, still)


def _make_skew(w: Float[Tensor, "B a"]) -> Float[Tensor, "B n n"]:
    """Generators of rotations by ``w`` [rad]: clockwise as seen in the image, about a vector in space."""
    zero = torch.zeros_like(w[:, 0])
    if w.shape[1] == 1:
        return torch.stack([zero, -w[:, 0], w[:, 0], zero], 1).unflatten(1, (2, 2))
    x, y, z = w.unbind(1)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).unflatten(1, (3, 3))


def _differentiate_rotation(
    w: Float[Tensor, "B a"], relative: Float[Tensor, "P n"]
) -> Float[Tensor, "B P n a"]:
    """Derivative of ``R(w) r`` by ``w``: ``-R [r]x J``, with the right Jacobian ``J`` of the rotation group.

    Source: Sola, Deray and Atchuthan, A micro Lie theory for state estimation in robotics, arXiv:1812.01537,
    eqs. (143) and (174).
    """
    skew = _make_skew(w)
    turn = torch.linalg.matrix_exp(skew)
    if w.shape[1] == 1:
        return (relative @ (turn @ _make_skew(torch.ones_like(w))).mT)[..., None]
    angle = w.norm(dim=1)[:, None, None].clamp(min=1e-6)
    eye = torch.eye(3, dtype=w.dtype)
    right = eye - (1 - torch.cos(angle)) / angle**2 * skew
    right = right + (angle - torch.sin(angle)) / angle**3 * (skew @ skew)
    return -turn[:, None] @ _make_skew(relative) @ right[:, None]
