from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from lagsplat.chart.chart import Chart, find_rest_image, fit_chart, load_chart, save_chart
from lagsplat.chart.config import ChartConfig
from lagsplat.io.files.artifact import load_artifact, save_artifact
from lagsplat.io.recording.recording import Recording
from lagsplat.stage1.autoencoder import Autoencoder, encode_frames

CONFIG = ChartConfig(
    smoothing_frames=1.0,
    rest_frames=5,
    eigenvalue_floor=1e-8,
    visibility_frames=4,
    visibility_step=1e-2,
    refinement_steps=0,
    dimension_frames=60,
    dimension_neighbours=5,
)


def made() -> tuple[Autoencoder, Recording, Chart]:
    torch.manual_seed(0)
    autoencoder = Autoencoder(
        d=2, n_gaussians=20, kernel=4, channels=2, height=12, width=12, background="learned", backend="torch"
    )
    with torch.no_grad():
        autoencoder.gaussians.center.uniform_(2, 10)
        autoencoder.gaussians.coupling.normal_()
        autoencoder.gaussians.color_logit.normal_()
        autoencoder.gaussians.precision_log_diagonal.fill_(-2.0)
    rng = np.random.default_rng(0)
    recording = Recording(
        frames=rng.integers(0, 255, (80, 12, 12, 3), dtype=np.uint8),
        time_s=0.02 * np.arange(80),
        inputs=rng.normal(size=(80, 1)),
        input_names=("p1",),
        input_units=("atm",),
        segments=((0, 50), (50, 80)),
        meta={"origin": "simulated", "source": "test", "sha256": None, "licence": None},
        n_train=60,
    )
    return autoencoder, recording, fit_chart(autoencoder, recording, CONFIG)


def test_chart_describes_the_recording_and_survives_a_file(tmp_path: Path) -> None:
    autoencoder, recording, chart = made()
    assert (chart.d, chart.n_train, len(chart.latents)) == (2, 60, 80)
    assert chart.train.segments == ((0, 50), (50, 60))
    assert chart.held_out.segments == ((0, 20),)
    np.testing.assert_allclose(np.cov(chart.train.latents, rowvar=False), np.eye(2), atol=1e-9)
    assert np.trace(chart.metric) == pytest.approx(2.0)
    raw = encode_frames(autoencoder, recording.frames)
    np.testing.assert_allclose(chart.to_raw(chart.latents), raw, atol=1e-6)
    np.testing.assert_allclose(chart.to_whitened(raw), chart.latents, atol=1e-6)
    save_chart(tmp_path / "chart.safetensors", chart, {"seed": 3})
    again, header = load_chart(tmp_path / "chart.safetensors")
    assert header["seed"] == 3
    assert again.segments == chart.segments
    for name in ("latents", "metric", "rest", "whiten"):
        np.testing.assert_array_equal(getattr(again, name), getattr(chart, name))
    assert again.metric_scale == chart.metric_scale


def test_a_chart_without_a_setting_is_refused(tmp_path: Path) -> None:
    _, _, chart = made()
    path = tmp_path / "chart.safetensors"
    save_chart(path, chart, {})
    tensors, header = load_artifact(path)
    del header["chart"]["refinement_steps"]
    save_artifact(path, tensors, header)
    with pytest.raises(ValueError, match=r"'chart' has no refinement_steps; version .* wrote it"):
        load_chart(path)


def test_held_out_frames_do_not_touch_the_chart() -> None:
    autoencoder, recording, chart = made()
    frames = np.array(recording.frames)
    frames[60:] = 255 - frames[60:]
    again = fit_chart(autoencoder, replace(recording, frames=frames), CONFIG)
    np.testing.assert_array_equal(again.whiten, chart.whiten)
    np.testing.assert_array_equal(again.metric, chart.metric)
    assert not np.array_equal(again.latents, chart.latents)


def test_rest_image_is_a_median_over_the_first_frames() -> None:
    _, recording, _ = made()
    got = find_rest_image(recording, n_train=60, rest_frames=3)
    assert got.dtype == np.uint8
    np.testing.assert_array_equal(got[0], np.median(recording.frames[:3], axis=0))


def test_a_recording_that_is_not_divided_is_refused() -> None:
    autoencoder, recording, _ = made()
    with pytest.raises(ValueError, match="divide the recording first"):
        fit_chart(autoencoder, replace(recording, n_train=None), CONFIG)
