"""Normal equations of multiple shooting: states of the windows are eliminated, parameters are left.

A state at the start of a window enters that window and, where windows are linked, the one before. So the
curvature by all states is block-diagonal or block-tridiagonal, and elimination in the order of time leaves a
system of the size of the parameters (Schur complement).

Source: Bock 1983, "Recent advances in parameter identification techniques for O.D.E.".
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64


@dataclass(frozen=True)
class NormalEquations:
    """The system ``[[states, mixed], [mixed^T, parameters]] x = -gradient``."""

    states: Float64[np.ndarray, "K s s"]
    mixed: Float64[np.ndarray, "K s p"]
    parameters: Float64[np.ndarray, "p p"]
    states_gradient: Float64[np.ndarray, "K s"]
    parameters_gradient: Float64[np.ndarray, " p"]
    link: Float64[np.ndarray, "K s s"] | None = None
    """Blocks between a state and the next, zero where windows are not linked; None if none are."""


@dataclass(frozen=True)
class EliminatedStates:
    """What the elimination of the states leaves: a system of the parameters, and the way back."""

    curvature: Float64[np.ndarray, "p p"]
    right: Float64[np.ndarray, " p"]  # the parameters' right-hand side
    states: Float64[np.ndarray, "K s s"]  # the diagonal blocks, the states before eliminated
    mixed: Float64[np.ndarray, "K s p"]
    states_right: Float64[np.ndarray, "K s"]
    link: Float64[np.ndarray, "K s s"] | None

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the curvature by all states."""
        return float(np.linalg.slogdet(self.states)[1].sum())

    def answer(self) -> Float64[np.ndarray, "K s p"]:
        """How far the best states move back when a parameter grows by one."""
        return self._substitute_back(self.mixed)

    def follow(self, step: Float64[np.ndarray, " p"]) -> Float64[np.ndarray, "K s"]:
        """The best step of the states, given that of the parameters."""
        return self._substitute_back((self.states_right - self.mixed @ step)[:, :, None])[:, :, 0]

    def _substitute_back(self, right: Float64[np.ndarray, "K s m"]) -> Float64[np.ndarray, "K s m"]:
        if self.link is None:
            return np.linalg.solve(self.states, right)
        found = np.empty_like(right)
        following = np.zeros_like(right[0])
        for i in range(len(right) - 1, -1, -1):
            found[i] = following = np.linalg.solve(self.states[i], right[i] - self.link[i] @ following)
        return found


def eliminate_states(normal: NormalEquations, *, damping: float = 0.0) -> EliminatedStates:
    """Eliminate the states in the order of time; ``damping`` adds that share to the diagonal of their blocks.

    Raises:
        numpy.linalg.LinAlgError: a state is not determined.
    """
    states, mixed, right = normal.states.copy(), normal.mixed, -normal.states_gradient
    diagonal = np.arange(states.shape[1])
    states[:, diagonal, diagonal] *= 1.0 + damping
    if normal.link is not None:
        mixed = mixed.copy()
        for i in range(1, len(states)):
            back = np.linalg.solve(states[i - 1], normal.link[i - 1])
            states[i] -= normal.link[i - 1].T @ back
            mixed[i] -= back.T @ mixed[i - 1]
            right[i] -= back.T @ right[i - 1]
    rows = (right.size, len(normal.parameters))
    solved = np.linalg.solve(states, mixed).reshape(rows)
    curvature = normal.parameters - mixed.reshape(rows).T @ solved
    left = -normal.parameters_gradient - solved.T @ right.ravel()
    return EliminatedStates(curvature, left, states, mixed, right, normal.link)


def solve_normal(
    normal: NormalEquations, *, damping: float
) -> tuple[Float64[np.ndarray, "K s"], Float64[np.ndarray, " p"]] | None:
    """Steps of states and parameters, or None where the equations are not positive definite.

    ``damping`` adds that share to the diagonal of the whole system (Marquardt 1963, DOI 10.1137/0111030).
    """
    try:
        left = eliminate_states(normal, damping=damping)
        factor = np.linalg.cholesky(left.curvature + damping * np.diag(np.diag(normal.parameters)))
    except np.linalg.LinAlgError:
        return None
    step = np.linalg.solve(factor.T, np.linalg.solve(factor, left.right))
    return left.follow(step), step
