"""A polynomial law from the noisy motion of a driven oscillator: frequency, decay, and what has no law."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2 import fit
from lagsplat.stage2.config import LikelihoodConfig
from lagsplat.stage2.equation_error import fit_equation_error
from lagsplat.stage2.fit import fit_dynamics, load_dynamics, save_dynamics
from lagsplat.stage2.lagrangian import linearize_modes
from lagsplat.stage2.rollout import interpolate_inputs, rollout
from tests.stage2_problems import form
from tests.unit.stage2.test_fit import config

DT_S, FREQUENCY_HZ, DECAY_PER_S, NOISE = 1 / 60, 4.0, 1.2, 0.01
POLYNOMIAL = form(terms="polynomial", potential_degree=4, input_degree=2, matrix_degree=1)


def push(time_s: np.ndarray | float) -> np.ndarray | float:
    return 0.8 * np.sin(2 * np.pi * 0.7 * time_s) + 0.5 * np.sin(2 * np.pi * 1.9 * time_s + 1.0)


@pytest.fixture(scope="module")
def motion() -> EncodedTrajectory:
    """A hardening oscillator far above the frequencies of its drive, released at the end, and noise."""
    omega2 = (2 * np.pi * FREQUENCY_HZ) ** 2 + DECAY_PER_S**2
    drive_s = 14.0

    def rate(t: float, state: np.ndarray) -> list[float]:
        q, v = state
        u = push(t) if t < drive_s else 0.0
        return [v, omega2 * (2.0 * u - q - 0.15 * q**3) - 2 * DECAY_PER_S * v]

    time_s = DT_S * np.arange(960)
    q = solve_ivp(rate, (0, time_s[-1]), [0.0, 0.0], t_eval=time_s, rtol=1e-9, atol=1e-9, max_step=0.01).y[0]
    inputs = np.where(time_s < drive_s, push(time_s), 0.0)
    noise = NOISE * q.std() * np.random.default_rng(0).standard_normal(len(q))
    scale = q.std()
    return EncodedTrajectory(((q + noise) / scale)[:, None], inputs[:, None], time_s, ((0, len(q)),))


def test_equation_error_comes_near_the_law_although_the_drive_is_slow(motion: EncodedTrajectory) -> None:
    smooth = replace(motion.smoothed(1.5), inputs=motion.inputs)
    law = fit_equation_error(smooth, POLYNOMIAL, time_unit_s=0.05, seed=0)
    modes = linearize_modes(law, torch.zeros(1, dtype=torch.float64))
    assert modes.frequency_hz[0] == pytest.approx(FREQUENCY_HZ, rel=0.15)


def test_the_likelihood_finds_frequency_and_decay_and_a_file_keeps_the_law(
    motion: EncodedTrajectory, tmp_path
) -> None:
    settings = config(form=POLYNOMIAL, likelihood=LikelihoodConfig(960, 10, 1.3))
    law, report = fit_dynamics(
        motion.smoothed(1.5), np.eye(1), settings, 0, rest=np.zeros(1), measured=motion
    )
    assert report.at_rest is not None
    assert report.at_rest.frequency_hz[0] == pytest.approx(FREQUENCY_HZ, rel=0.01)
    assert report.at_rest.decay_per_s[0] == pytest.approx(DECAY_PER_S, rel=0.1)
    assert report.scores["likelihood"] < min(0.05, report.scores["start"])
    assert {row.stage for row in report.curve} == {"start", "likelihood"}
    save_dynamics(tmp_path / "dynamics.safetensors", law, {})
    again, _ = load_dynamics(tmp_path / "dynamics.safetensors")
    q, v = torch.zeros(2, 1, 1, dtype=torch.float64)
    u = torch.from_numpy(motion.inputs[None, :50])
    for one, other in zip(rollout(law, q, v, u, dt_s=DT_S), rollout(again, q, v, u, dt_s=DT_S), strict=True):
        assert torch.equal(one, other)


def test_what_forecasts_nothing_is_refused_and_so_is_a_clip_without_accelerations(
    motion: EncodedTrajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    noise = np.random.default_rng(1).standard_normal(motion.latents.shape)
    settings = config(form=replace(POLYNOMIAL, potential_degree=3), likelihood=LikelihoodConfig(400, 2, 1.3))
    # a law that only decays to the mean forecasts noise as well as the mean does, by chance a little better
    monkeypatch.setattr(fit, "MEAN_STATE", 0.5)
    with pytest.raises(ValueError, match=r"no polynomial law of degree 2 to 3 .* mean state"):
        fit_dynamics(replace(motion, latents=noise), np.eye(1), settings, 0, rest=np.zeros(1))
    short = EncodedTrajectory(motion.latents[:7], motion.inputs[:7], motion.time_s[:7], ((0, 7),))
    with pytest.raises(ValueError, match=r"7 frames, and accelerations need more than 8"):
        fit_equation_error(short, POLYNOMIAL, time_unit_s=0.05, seed=0)


def test_inputs_between_frames_are_those_of_a_smooth_curve() -> None:
    time = torch.arange(7, dtype=torch.float64)
    parabola = (1.0 - 2.0 * time + 0.5 * time**2)[None, :, None]
    between = interpolate_inputs(parabola, nodes=5)
    at = time[:-1, None] + torch.linspace(0, 1, 5, dtype=torch.float64)
    torch.testing.assert_close(between[0, :, :, 0], 1.0 - 2.0 * at + 0.5 * at**2)
    two = interpolate_inputs(parabola[:, :2], nodes=3)
    torch.testing.assert_close(two[0, 0, 1], 0.5 * (parabola[0, 0] + parabola[0, 1]))
