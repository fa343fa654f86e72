"""A polynomial law from the noisy motion of a driven oscillator: frequency, decay, and what has no law."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.integrate import solve_ivp

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.config import LikelihoodConfig
from lagsplat.stage2.equilibrium import LinearizedModes, linearize_modes, list_stable_equilibria
from lagsplat.stage2.fit import FitReport, fit_dynamics, load_dynamics, save_dynamics
from lagsplat.stage2.likelihood import likelihood_fit
from lagsplat.stage2.rollout import interpolate_inputs, rollout
from lagsplat.stage2.weak_form import fit_weak_form
from tests.stage2_problems import form, random_lagrangian
from tests.unit.stage2.test_fit import config

DT_S, FREQUENCY_HZ, DECAY_PER_S, NOISE = 1 / 60, 4.0, 1.2, 0.01
POLYNOMIAL = form(terms="polynomial", potential_degree=4, input_degree=2, matrix_degree=1, map_degree=2)


def push(time_s: np.ndarray | float) -> np.ndarray | float:
    return 0.8 * np.sin(2 * np.pi * 0.7 * time_s) + 0.5 * np.sin(2 * np.pi * 1.9 * time_s + 1.0)


@pytest.fixture(scope="module")
def motion() -> EncodedTrajectory:
    return record_motion(hardening=0.15)


def record_motion(hardening: float) -> EncodedTrajectory:
    """An oscillator far above the frequencies of its drive, released at the end, and noise."""
    omega2 = (2 * np.pi * FREQUENCY_HZ) ** 2 + DECAY_PER_S**2
    drive_s = 14.0

    def rate(t: float, state: np.ndarray) -> list[float]:
        q, v = state
        u = push(t) if t < drive_s else 0.0
        return [v, omega2 * (2.0 * u - q - hardening * q**3) - 2 * DECAY_PER_S * v]

    time_s = DT_S * np.arange(960)
    q = solve_ivp(rate, (0, time_s[-1]), [0.0, 0.0], t_eval=time_s, rtol=1e-9, atol=1e-9, max_step=0.01).y[0]
    inputs = np.where(time_s < drive_s, push(time_s), 0.0)
    noise = NOISE * q.std() * np.random.default_rng(0).standard_normal(len(q))
    scale = q.std()
    return EncodedTrajectory(((q + noise) / scale)[:, None], inputs[:, None], time_s, ((0, len(q)),))


def test_the_weak_form_finds_the_frequency_although_the_drive_is_slow(motion: EncodedTrajectory) -> None:
    law = fit_weak_form(motion, POLYNOMIAL, half_width=8, time_unit_s=0.05, seed=0)
    modes = linearize_modes(law, torch.zeros(1, dtype=torch.float64))
    assert modes.frequency_hz[0] == pytest.approx(FREQUENCY_HZ, rel=0.03)


def test_the_weak_form_keeps_the_stiffness_of_a_coordinate_that_noise_hides() -> None:
    """Of two masses the second moves thrice as much as its noise; its balance holds at zero, too."""
    stiffness = (2 * np.pi) ** 2 * np.array([[2.0, 0.4], [0.4, 9.0]])
    time_s = DT_S * np.arange(3000)

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        pushed = np.array([push(t), 3.0 * push(1.3 * t + 0.4)])
        return np.concatenate([state[2:], 15.0 * pushed - stiffness @ state[:2] - 1.6 * state[2:]])

    q = solve_ivp(rate, (0, time_s[-1]), np.zeros(4), t_eval=time_s, rtol=1e-8, max_step=0.01).y[:2].T
    q = q / q.std(axis=0) + np.random.default_rng(0).standard_normal(q.shape) * [0.01, 0.3]
    inputs = np.stack([push(time_s), push(1.3 * time_s + 0.4)], axis=1)
    noisy = EncodedTrajectory(q, inputs, time_s, ((0, len(q)),))
    quartic = replace(POLYNOMIAL, potential_degree=4, input_degree=1, matrix_degree=0)
    law = fit_weak_form(noisy, quartic, half_width=16, time_unit_s=0.1, seed=0)
    modes = linearize_modes(law, torch.zeros(2, dtype=torch.float64))
    true = np.sqrt(np.linalg.eigvalsh(stiffness) - 0.8**2) / (2 * np.pi)
    assert modes.frequency_hz[0] == pytest.approx(true[0], rel=0.03)
    assert modes.frequency_hz[1] == pytest.approx(true[1], rel=0.3)


def test_the_weak_form_counts_uneven_times(motion: EncodedTrajectory) -> None:
    kept = np.flatnonzero(np.random.default_rng(0).random(len(motion.latents)) > 0.1)
    parts = motion.latents[kept], motion.inputs[kept], motion.time_s[kept]
    law = fit_weak_form(
        EncodedTrajectory(*parts, ((0, len(kept)),)), POLYNOMIAL, half_width=8, time_unit_s=0.05, seed=0
    )
    modes = linearize_modes(law, torch.zeros(1, dtype=torch.float64))
    assert modes.frequency_hz[0] == pytest.approx(FREQUENCY_HZ, rel=0.05)


def test_the_likelihood_finds_frequency_and_decay_and_a_file_keeps_the_law(
    motion: EncodedTrajectory, tmp_path
) -> None:
    settings = config(form=POLYNOMIAL, likelihood=LikelihoodConfig(960, 10, 1.3, 4))
    law, report = fit_dynamics(
        motion.smoothed(1.5), np.eye(1), settings, 0, rest=np.zeros(1), measured=motion
    )
    assert report.at_rest is not None
    assert report.at_rest.frequency_hz[0] == pytest.approx(FREQUENCY_HZ, rel=0.01)
    assert report.at_rest.decay_per_s[0] == pytest.approx(DECAY_PER_S, rel=0.1)
    assert report.scores["likelihood"] < 0.05
    assert {row.stage for row in report.curve} == {"start", "likelihood"}
    save_dynamics(tmp_path / "dynamics.safetensors", law, {})
    again, _ = load_dynamics(tmp_path / "dynamics.safetensors")
    q, v = torch.zeros(2, 1, 1, dtype=torch.float64)
    u = torch.from_numpy(motion.inputs[None, :50])
    for one, other in zip(rollout(law, q, v, u, dt_s=DT_S), rollout(again, q, v, u, dt_s=DT_S), strict=True):
        assert torch.equal(one, other)


def test_what_forecasts_nothing_is_refused_and_so_is_a_clip_shorter_than_a_bump(
    motion: EncodedTrajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    noise = np.random.default_rng(1).standard_normal(motion.latents.shape)
    settings = config(
        form=replace(POLYNOMIAL, potential_degree=3), likelihood=LikelihoodConfig(400, 2, 1.3, 4)
    )
    # a law that only decays to the mean forecasts noise as well as the mean does, by chance a little better
    monkeypatch.setattr(likelihood_fit, "MEAN_STATE", 0.5)
    with pytest.raises(ValueError, match=r"no polynomial law of degree 2 to 3 .* mean state"):
        fit_dynamics(replace(motion, latents=noise), np.eye(1), settings, 0, rest=np.zeros(1))
    short = EncodedTrajectory(motion.latents[:7], motion.inputs[:7], motion.time_s[:7], ((0, 7),))
    with pytest.raises(ValueError, match=r"7 frames, and a bump of the weak form needs 9"):
        fit_weak_form(short, POLYNOMIAL, half_width=4, time_unit_s=0.05, seed=0)


def test_inputs_between_frames_are_those_of_a_smooth_curve() -> None:
    time = torch.arange(7, dtype=torch.float64)
    parabola = (1.0 - 2.0 * time + 0.5 * time**2)[None, :, None]
    between = interpolate_inputs(parabola, nodes=5)
    at = time[:-1, None] + torch.linspace(0, 1, 5, dtype=torch.float64)
    torch.testing.assert_close(between[0, :, :, 0], 1.0 - 2.0 * at + 0.5 * at**2)
    two = interpolate_inputs(parabola[:, :2], nodes=3)
    torch.testing.assert_close(two[0, 0, 1], 0.5 * (parabola[0, 0] + parabola[0, 1]))


def test_equilibria_of_a_double_well_are_found_and_said() -> None:
    law = random_lagrangian(2, 1, 0, amount=0.0, terms="polynomial", potential_degree=4)
    assert law.energy is not None
    powers = law.energy.exponents.tolist()
    with torch.no_grad():
        law.energy.coefficients.zero_()
        law.energy.input_coefficients.zero_()
        for exponents, value in ([2.0, 0.0], -1.0), ([4.0, 0.0], 0.5), ([0.0, 2.0], 1.0):
            law.energy.coefficients[powers.index(exponents)] = value
        law.energy.input_coefficients[0, 0] = 3.0  # pushes along the first coordinate
    free, pushed = list_stable_equilibria(law, torch.tensor([[0.0], [1.0]], dtype=torch.float64))
    assert sorted(free[:, 0].tolist()) == pytest.approx([-1.0, 1.0], abs=1e-3)
    assert len(pushed) == 1
    assert "2 stable equilibria" in FitReport(equilibria=2, draws=np.zeros((1, 1))).warnings[0]
    assert FitReport(equilibria=1, draws=np.zeros((1, 1))).warnings == FitReport().warnings == []
    remote = FitReport(equilibria=1, draws=np.zeros((1, 1)), rest_beyond=0.997)
    assert "farther out than 99.7% of the recorded states" in remote.warnings[0]
    quiet = FitReport(equilibria=1, draws=np.zeros((1, 1)), quietest_hz=0.63)
    quiet.at_rest = LinearizedModes([0.0], [0.49], [0.1])
    assert "0.63 Hz at the smallest amplitude" in quiet.warnings[0]
    quiet.at_rest = LinearizedModes([0.0], [0.627], [0.1])
    assert not quiet.warnings
    assert "stage2.steps=20 has no effect" in FitReport(unused_steps=20).warnings[0]


@pytest.mark.parametrize(("hardening", "degree"), [(0.0, 2), (0.15, 4)])
def test_the_potential_has_no_higher_degree_than_the_motion_tells(hardening: float, degree: int) -> None:
    settings = config(form=replace(POLYNOMIAL, matrix_degree=0, map_degree=1))
    law, _ = fit_dynamics(record_motion(hardening), np.eye(1), settings, 0, rest=np.zeros(1))
    assert law.form.potential_degree == degree
