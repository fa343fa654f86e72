"""Motions of one coordinate under inputs, as encoded states of a training part."""

import numpy as np
import scipy.linalg

from lagsplat.evaluate.protocol import STENCILS, EvaluationSeries

DT_S = 0.02
OSCILLATOR = np.array([[0.0, 1.0, 0.0], [-30.0, -0.4, 30.0], [0.0, 0.0, 0.0]])  # of (q, v, u)


def simulate(inputs: np.ndarray, state: tuple[float, float]) -> np.ndarray:
    """States (T, 2) of a damped oscillator whose input is held over each step."""
    step = scipy.linalg.expm(DT_S * OSCILLATOR)[:2]
    states = [np.array(state)]
    for u in inputs[:-1, 0]:
        states.append(step @ [*states[-1], u])
    return np.array(states)


def train_on(
    q: np.ndarray, inputs: np.ndarray, segments: tuple[tuple[int, int], ...] | None = None
) -> EvaluationSeries:
    return EvaluationSeries(
        encoded=q,
        latents=q,
        forcing=inputs,
        inputs=inputs,
        segments=segments or ((0, len(q)),),
        metric=np.eye(q.shape[1]),
        dt_s=DT_S,
        skip=0,
        stencil=STENCILS["central"],
    )


def swing_pendulum(inputs: np.ndarray, state: tuple[float, float]) -> np.ndarray:
    """States (T, 2) of a damped pendulum that swings far, driven by a torque."""
    rows, fine = [np.array(state)], 20
    for u in inputs[:-1, 0]:
        q, v = rows[-1]
        for _ in range(fine):
            v = v + DT_S / fine * (u - 25.0 * np.sin(q) - 0.2 * v)
            q = q + DT_S / fine * v
        rows.append(np.array([q, v]))
    return np.array(rows)
