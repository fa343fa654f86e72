from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.io.files.artifact import load_artifact, save_artifact
from lagsplat.stage2.config import (
    FloorConfig,
    LikelihoodConfig,
    SelectConfig,
    Stage2Config,
    StartConfig,
)
from lagsplat.stage2.fit import choose_time_unit, fit_dynamics, load_dynamics, save_dynamics
from lagsplat.stage2.rollout import rollout
from tests.stage2_problems import form, random_lagrangian

DT_S, FREQUENCY_HZ, DECAY_PER_S = 1.0 / 60.0, 1.5, 0.4


def oscillator(n: int, *, driven: bool) -> EncodedTrajectory:
    """One damped coordinate of known frequency and decay, under a slow random input."""
    omega, rng = 2 * np.pi * FREQUENCY_HZ, np.random.default_rng(0)
    u = np.convolve(rng.normal(size=n + 60), np.hanning(61), mode="valid") if driven else np.zeros(n)
    fine, q, v, path = 20, 1.0, 0.0, []
    for i in range(n):
        path.append(q)
        for _ in range(fine):
            v += DT_S / fine * (-(omega**2) * (q - 0.05 * u[i]) - 2 * DECAY_PER_S * v)
            q += DT_S / fine * v
    inputs = u[:, None] if driven else np.zeros((n, 0))
    return EncodedTrajectory(np.array(path)[:, None], inputs, DT_S * np.arange(n), ((0, n),))


def config(**changes: object) -> Stage2Config:
    values = {
        "form": form(matrix_width=8, potential_width=8, diffeo_width=8),
        "floor": FloorConfig(1e-2, 1e-3, 1e-2),
        "start": StartConfig("fitted", 60, "data", 0.2, 1.0),
        "stride_frames": 1,
        "integrator": "verlet",
        "longest_step": 0.25,
        "effort": 1.0,
        "ridge": 1.0,
        "velocity_weight": 1.0,
        "steps": 4,
        "batch": 16,
        "lr": 1e-3,
        "final_fraction": 0.1,
        "gradient_clip": 10.0,
        "select": SelectConfig(8, 1.0, 2),
        "likelihood": LikelihoodConfig(600, 8, 1.3, 4),
    }
    if changes.get("form", values["form"]).terms == "polynomial":
        values |= {"start": replace(values["start"], source="likelihood"), "integrator": "runge_kutta"}
    return Stage2Config(**(values | changes))


@pytest.mark.parametrize("driven", [False, True])
def test_frequency_and_decay_of_a_known_system_are_found(driven: bool) -> None:
    trajectory = oscillator(500, driven=driven)
    lagrangian, report = fit_dynamics(trajectory, np.eye(1), config(), 0, rest=np.zeros(1))
    assert report.at_rest is not None
    assert report.at_rest.frequency_hz[0] == pytest.approx(FREQUENCY_HZ, rel=0.01)
    assert report.at_rest.decay_per_s[0] == pytest.approx(DECAY_PER_S, rel=0.1)
    assert report.scores["one_step"] <= report.scores["start"] < 0.05
    assert lagrangian.n_inputs == int(driven)


def test_same_seed_same_result_and_a_file_gives_the_same_forecast(tmp_path: Path) -> None:
    trajectory = oscillator(200, driven=True)
    first, _ = fit_dynamics(trajectory, np.eye(1), config(), 3, rest=np.zeros(1))
    second, _ = fit_dynamics(trajectory, np.eye(1), config(), 3, rest=np.zeros(1))
    for a, b in zip(first.parameters(), second.parameters(), strict=True):
        assert torch.equal(a, b)
    save_dynamics(tmp_path / "dynamics.safetensors", first, {"seed": 3})
    again, header = load_dynamics(tmp_path / "dynamics.safetensors")
    assert header["dynamics"]["time_unit_s"] == pytest.approx(float(first.time_unit_s))
    q, v = torch.randn(2, 3, 1, dtype=torch.float64)
    inputs = torch.rand(3, 10, 1, dtype=torch.float64)
    torch.testing.assert_close(
        rollout(again, q, v, inputs, dt_s=DT_S), rollout(first, q, v, inputs, dt_s=DT_S), rtol=0, atol=0
    )


def test_a_law_of_other_settings_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "dynamics.safetensors"
    save_dynamics(path, random_lagrangian(1, 0, 0), {})
    tensors, header = load_artifact(path)
    settings = header["dynamics"]
    for changed, message in (
        ({name: value for name, value in settings.items() if name != "integrator"}, "has no integrator"),
        ({**settings, "form": {**settings["form"], "springs": 2}}, "has an unknown springs"),
    ):
        save_artifact(path, tensors, {**header, "dynamics": changed})
        with pytest.raises(
            ValueError, match=f"'dynamics' {message}; version .* wrote it. Make the file again"
        ):
            load_dynamics(path)


def test_a_fixed_rest_stays_and_the_published_start_runs() -> None:
    trajectory = oscillator(200, driven=False)
    fixed = config(
        form=replace(form(matrix_width=8), rest="fixed", potential="icnn"),
    )
    lagrangian, _ = fit_dynamics(trajectory, np.eye(1), fixed, 0, rest=np.array([0.1]))
    assert float(lagrangian.rest[0]) == 0.1
    published = config(start=StartConfig("isotropic", 1, "frame", 0.5, 0.05))
    lagrangian, report = fit_dynamics(trajectory, np.eye(1), published, 0, rest=np.zeros(1))
    assert float(lagrangian.time_unit_s) == pytest.approx(DT_S)
    assert np.isfinite(report.scores["one_step"])


def test_time_unit_is_that_of_the_mechanism_under_a_slow_drive() -> None:
    trajectory = oscillator(400, driven=False)
    drift = 50.0 * np.sin(2 * np.pi * np.arange(400) / 400)[:, None] * trajectory.latents.std()
    slow = replace(trajectory, latents=trajectory.latents + drift)
    assert choose_time_unit(slow, np.eye(1), stride_frames=2) < 4.0 / (2 * np.pi * FREQUENCY_HZ)


def test_time_unit_is_the_period_over_two_pi_and_constant_latents_are_refused() -> None:
    trajectory = oscillator(400, driven=False)
    unit = choose_time_unit(trajectory, np.eye(1), stride_frames=2)
    assert unit == pytest.approx(1.0 / (2 * np.pi * FREQUENCY_HZ), rel=0.05)
    with pytest.raises(ValueError, match="do not move"):
        choose_time_unit(replace(trajectory, latents=np.ones((400, 1))), np.eye(1), stride_frames=2)


def test_effort_is_a_share_of_the_steps() -> None:
    _, whole = fit_dynamics(oscillator(200, driven=False), np.eye(1), config(), 0, rest=np.zeros(1))
    _, half = fit_dynamics(oscillator(200, driven=False), np.eye(1), config(effort=0.5), 0, rest=np.zeros(1))
    for report, steps in ((whole, 4), (half, 2)):
        assert max(row.step for row in report.curve if row.stage == "one_step") == steps


def test_a_low_frame_rate_does_not_bias_the_physics() -> None:
    """Ten frames a period: one Verlet step a frame is off by more than a per cent in frequency."""
    fine = oscillator(800, driven=False)
    trajectory = EncodedTrajectory(fine.latents[::4], fine.inputs[::4], fine.time_s[::4], ((0, 200),))
    found = {}
    for settings in (config(form=form(terms="polynomial")), config()):
        _, report = fit_dynamics(trajectory, np.eye(1), settings, 0, rest=np.zeros(1))
        assert report.at_rest is not None
        found[settings.start.source] = abs(report.at_rest.frequency_hz[0] / FREQUENCY_HZ - 1)
    assert found["likelihood"] < 0.005
    assert found["fitted"] > 3 * found["likelihood"]
