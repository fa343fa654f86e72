"""What `lagsplat inspect` says of a recording made for the purpose."""

import numpy as np
import pytest

from lagsplat.config.compose import compose
from lagsplat.io.recording.recording import Recording
from lagsplat.report.inspection import describe_recording

DT_S = 0.02


def recording(n: int = 400) -> Recording:
    time_s = DT_S * np.arange(n)
    time_s[250:] += 1.0
    inputs = np.where(np.arange(n)[:, None] < 200, np.cos(np.pi / 10 * np.arange(n))[:, None], 0.5)
    return Recording(
        frames=np.random.default_rng(0).integers(0, 256, (n, 6, 8, 3), dtype=np.uint8),
        time_s=time_s,
        inputs=inputs,
        input_names=("p1",),
        input_units=("atm",),
        meta={"origin": "simulated", "source": "by hand", "sha256": None, "licence": "none"},
        n_train=3 * n // 4,
    )


def test_every_fact_is_said() -> None:
    text = describe_recording(recording(), config=compose("system=toy").evaluate)
    assert "by hand (simulated)" in text
    assert "400, 8 x 6 px, 1 clip(s)" in text
    assert "50.0000 frames/s" in text
    assert "input p1   -1 to 1 atm" in text
    assert "1.020 s after frame 249" in text
    assert "300 frames to train on, 100 held out" in text
    free = next(line for line in text.splitlines() if line.startswith("free"))
    assert "to 400 (4.0 s)" in free


def test_a_recording_that_is_not_divided_is_refused() -> None:
    with pytest.raises(ValueError, match="divide the recording first"):
        describe_recording(recording(300).part(0, 5), config=compose("system=toy").evaluate)
