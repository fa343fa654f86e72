"""Inputs at the rate of their log, for motions whose samples are means of several.

What actuators do with an input, such as taking up play, depends on every sample. Only what comes out of them,
a force, may be averaged.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

MEAN_OF_BEND, MEAN_OF_CORNER = 1.0 / 2.0, 3.0 / 2.0
"""Mean of a parabola, and of straight lines through its samples, over the span of a mean: what it exceeds the
value in the middle by, over the second derivative times the variance of the times."""


@dataclass(frozen=True)
class LoggedInputs:
    """Inputs ``u`` (M, n_u) at ``time_s`` (M,) in clips, of which ``n`` at a time make up one mean.

    ``segments`` are half-open clips of whole groups that cover all samples. ``held`` inputs are constant from
    one sample to the next, others are linear.
    """

    time_s: Float64[np.ndarray, " M"]
    u: Float64[np.ndarray, "M n_u"]
    segments: tuple[tuple[int, int], ...]
    n: int
    held: bool

    def average(self, values: Float64[np.ndarray, "M k"]) -> Float64[np.ndarray, "N k"]:
        """Values at the means' times that act like ``values`` at the log's.

        Held values are averaged from one middle to the next. Others become the corners of straight lines that
        have the same means.
        """
        if not self.held:
            return average_groups(self.time_s, values, self.segments, self.n, bend=MEAN_OF_CORNER)
        means = []
        for start, stop in self.segments:
            at = np.arange(start, stop)
            middles = [values[np.minimum(at + ahead, stop - 1)] for ahead in ((self.n - 1) // 2, self.n // 2)]
            means.append(np.mean(middles, axis=0).reshape(-1, self.n, values.shape[1]).mean(axis=1))
        return np.concatenate(means)


def average_groups(
    time_s: Float64[np.ndarray, " M"],
    values: Float64[np.ndarray, "M k"],
    segments: tuple[tuple[int, int], ...],
    n: int,
    *,
    bend: float = MEAN_OF_BEND,
) -> Float64[np.ndarray, "N k"]:
    """Values in the middle of each ``n`` samples, whose means exceed them by ``bend``.

    The second derivative is that of the means, continued to both ends of a clip, and zero for fewer than four
    of them.

    Source: values from cell averages, Shu 1998, doi:10.1007/BFb0096355.
    """
    middles = []
    for start, stop in segments:
        times = time_s[start:stop].reshape(-1, n)
        means = values[start:stop].reshape(len(times), n, -1).mean(axis=1)
        if len(means) >= 4:
            at_s = times.mean(axis=1)
            slopes = np.diff(means, axis=0) / np.diff(at_s)[:, None]
            second = 2.0 * np.diff(slopes, axis=0) / (at_s[2:] - at_s[:-2])[:, None]
            second = np.pad(second, ((1, 1), (0, 0)), mode="reflect", reflect_type="odd")
            means = means - bend * second * times.var(axis=1)[:, None]
        middles.append(means)
    return np.concatenate(middles)
