"""Laws of the chart: what may not depend on the coordinates the encoder happened to pick."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from lagsplat.chart.visibility import fit_whitening, measure_visibility

seeds = st.integers(0, 2**31 - 1)


@settings(max_examples=25, deadline=None)
@given(seed=seeds, d=st.integers(1, 4))
def test_whitened_distances_do_not_depend_on_the_raw_coordinates(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(200, d)) * rng.uniform(0.3, 3.0, d)
    other = z @ (rng.normal(size=(d, d)) + 3.0 * np.eye(d)) + rng.normal(size=d)
    a, b = fit_whitening(z, eigenvalue_floor=1e-9), fit_whitening(other, eigenvalue_floor=1e-9)
    qa, qb = (z - a.mean) @ a.whiten, (other - b.mean) @ b.whiten
    np.testing.assert_allclose(qa @ qa.T, qb @ qb.T, atol=1e-7)


@settings(max_examples=15, deadline=None)
@given(seed=seeds, d=st.integers(1, 3))
def test_visible_lengths_do_not_depend_on_the_chart(seed: int, d: int) -> None:
    rng = np.random.default_rng(seed)
    weights = torch.from_numpy(rng.normal(size=(d, 12)))
    change = rng.normal(size=(d, d)) + 2.0 * np.eye(d)
    q = rng.normal(size=(20, d))

    def decode(x: Tensor) -> Tensor:
        return torch.tanh(0.5 * x @ weights).view(-1, 3, 2, 2)

    plain = measure_visibility(decode, q, step=1e-3)
    moved = measure_visibility(
        lambda y: decode(y @ torch.from_numpy(change)), q @ np.linalg.inv(change), step=1e-4
    )
    direction = rng.normal(size=d)
    pulled = direction @ np.linalg.inv(change)
    np.testing.assert_allclose(
        direction @ plain.metric @ direction * plain.scale,
        pulled @ moved.metric @ pulled * moved.scale,
        rtol=1e-4,
    )
