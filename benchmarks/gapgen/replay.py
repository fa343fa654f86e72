"""The true mechanism of a recording, with its effects, put to further experiments."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.gapgen.drawing import Recording
from benchmarks.gapgen.files import columns_of
from benchmarks.gapgen.motion import Plan, seen
from benchmarks.gapgen.sensors import noisy
from benchmarks.gapgen.sources import world_of

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrueMechanism:
    """The mechanism of a recording drawn with exact nominal parameters, one clip and white noise."""

    recording: Recording
    noise: float  # of a sample, over the rms of its coordinate in the first recording

    def play(self, dt_s: float, u: Array, x0: Array, rng: np.random.Generator) -> dict[str, Array]:
        """Columns of a recording from the state ``x0`` (2 d,) under inputs ``u`` (T, n_u) every ``dt_s``.

        Raises:
            FloatingPointError: the motion leaves every bound.
        """
        nominal, effects = self.recording.nominal, self.recording.truth["found"]
        assert nominal is not None
        clips = world_of(nominal, effects).move(Plan(dt_s, [0.0], [x0], [0], [u]))
        clean = seen(clips, effects, nominal.d, dt_s)
        sigma = self.noise * np.array(self.recording.truth["rms"])
        forced = self.recording.truth["u_rms"] != []
        return columns_of(clips, noisy(clean, sigma, rng), dt_s, inputs=forced, offset=None)

    def repeat(self, rng: np.random.Generator, *, off: float) -> dict[str, Array]:
        """The first recording once more: the same inputs, other noise, a start off by ``off`` of the rms."""
        first = self.recording.files["real_0.csv"]
        names = [name for name in first if name[0] == "u"]
        d, dt_s = len(self.recording.truth["rms"]), float(np.median(np.diff(first["t"])))
        q = np.stack([first[f"q{i}"] for i in range(d)], axis=1)
        v = np.polyfit(dt_s * np.arange(10), q[:10], 2)[1]
        x0 = np.concatenate([q[0], v])
        rms = np.concatenate([q.std(axis=0), np.gradient(q, dt_s, axis=0).std(axis=0)])
        u = np.stack([first[name] for name in names], axis=1) if names else np.zeros((len(q), 0))
        if not names:
            u = np.zeros((len(q), self.recording.nominal.n_u if self.recording.nominal else 0))
        return self.play(dt_s, u, x0 + off * rms * rng.standard_normal(2 * d), rng)
