import numpy as np
import torch

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.rollout import rollout
from lagsplat.stage2.training import BestCheckpoint, draw_validation_task
from tests.stage2_problems import random_lagrangian


def test_the_true_dynamics_scores_near_zero_and_a_diverging_one_infinite() -> None:
    lagrangian = random_lagrangian(1, 0, 0, amount=0.05)
    dt = 0.02 * float(lagrangian.time_unit_s)
    q = torch.full((1, 1), 1.0, dtype=torch.float64)
    path, _ = rollout(lagrangian, q, 0 * q, torch.zeros(1, 300, 0, dtype=torch.float64), dt_s=dt)
    trajectory = EncodedTrajectory(path[0].numpy(), np.zeros((300, 0)), dt * np.arange(300), ((0, 300),))
    validation = draw_validation_task(trajectory, torch.eye(1, dtype=torch.float64), starts=5, n_states=1000)
    score = validation.score(lagrangian)
    assert score < 0.02
    best = BestCheckpoint()
    best.consider(lagrangian, score)
    kept = lagrangian.rest.detach().clone()
    with torch.no_grad():
        lagrangian.rest.fill_(torch.nan)
    worse = validation.score(lagrangian)
    assert worse == float("inf")
    best.consider(lagrangian, worse)
    assert best.rejected == 1
    best.restore(lagrangian)
    assert torch.equal(lagrangian.rest.detach(), kept)
