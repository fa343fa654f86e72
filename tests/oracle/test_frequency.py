"""The frequency estimators on the free tails of shared recordings, against what others measured there.

The latents are the leading principal components of the frames, so that no network takes part.
"""

from pathlib import Path

import numpy as np
import pytest

from lagsplat.evaluate.modes import fit_modes
from lagsplat.evaluate.spectrum import find_spectral_peak

DT_S = 1001 / 60000
RELEASE = 19400


def components(path: Path, d: int) -> tuple[np.ndarray, np.ndarray]:
    """Whitened principal components of the free tail of a recording, and their visibility."""
    if not path.is_file():
        pytest.skip(f"no {path}")
    with np.load(path) as archive:
        images = archive["images"][RELEASE - 3600 :]
    flat = images.reshape(len(images), -1).astype(np.float32) / 255
    mean = flat.mean(axis=0)
    sample = (flat[::12] - mean).astype(np.float64)
    values, vectors = np.linalg.eigh(sample @ sample.T)
    values, vectors = values[-d:], vectors[:, -d:]
    basis = sample.T @ vectors / np.sqrt(values)
    tail = (flat[3600:] - mean) @ basis / np.sqrt(values / len(sample))
    return tail, np.diag(values * d / values.sum())


@pytest.fixture(scope="module", params=["2seg_32x32_59fps_TWIN", "1seg_32x32_59fps_TWIN_alt_osc_deconv"])
def ringing(request, shared_data) -> tuple[np.ndarray, np.ndarray, float]:
    path = shared_data / "krauss_twin" / f"scr_dataset_raw_{request.param}.npz"
    expected_hz = {"2": 1.437, "1": 3.10}[request.param[0]]
    return (*components(path, 4), expected_hz)


def test_ringing_tails(ringing):
    """Weakly damped tails, whole and in a window of eight cycles: both estimators within one per cent."""
    tail, metric, expected_hz = ringing
    window = tail[: round(8 / (expected_hz * DT_S))]
    for series in (tail, window):
        peak = find_spectral_peak(series, dt_s=DT_S, metric=metric, min_cycles=1.5)
        mode = fit_modes(series, dt_s=DT_S, metric=metric, most=3)[0]
        assert peak.visible_hz == pytest.approx(expected_hz, rel=0.015)
        assert mode.frequency_hz == pytest.approx(expected_hz, rel=0.015)


def test_decay_of_the_two_segment_tail(shared_data):
    """In the generator's own linear coordinates: a damping ratio of 0.019 at 1.437 Hz.

    In images the first cycles saturate, so that a rate read there is smaller, and harmonics appear.
    """
    path = shared_data / "krauss_twin" / "scr_dataset_raw_2seg_32x32_59fps_TWIN_latents.npz"
    if not path.is_file():
        pytest.skip(f"no {path}")
    with np.load(path) as archive:
        tail = archive["z"][RELEASE + 5 :].astype(np.float64)
    mode = fit_modes(tail, dt_s=DT_S, metric=np.eye(tail.shape[1]), most=3)[0]
    assert mode.frequency_hz == pytest.approx(1.437, rel=0.005)
    assert mode.rate_per_s == pytest.approx(0.019 * 2 * np.pi * 1.437, rel=0.05)


def test_strongly_damped_tail(shared_data):
    """Gone in a second: the whole tail's spectrum resolves nothing, the fit finds 2.67 to 2.70 Hz."""
    path = shared_data / "krauss_twin" / "scr_dataset_raw_1seg_32x32_59fps_TWIN.npz"
    tail, metric = components(path, 2)
    for frames in (180, 600):
        mode = fit_modes(tail[:frames], dt_s=DT_S, metric=metric, most=3)[0]
        assert mode.frequency_hz == pytest.approx(2.68, rel=0.03)
