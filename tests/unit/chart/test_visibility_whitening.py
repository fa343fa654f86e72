import numpy as np
import pytest

from lagsplat.chart.visibility import fit_whitening


def latents(n: int = 500, d: int = 3) -> np.ndarray:
    rng = np.random.default_rng(1)
    return rng.normal(size=(n, d)) @ rng.normal(size=(d, d)) + rng.normal(size=d)


def test_training_latents_become_white_and_come_back() -> None:
    z = latents()
    white = fit_whitening(z, eigenvalue_floor=1e-6)
    q = (z - white.mean) @ white.whiten
    np.testing.assert_allclose(np.cov(q, rowvar=False), np.eye(3), atol=1e-10)
    np.testing.assert_allclose(white.mean + q @ white.unwhiten, z, atol=1e-10)


def test_largest_variance_comes_first_and_signs_are_fixed() -> None:
    z = latents()
    white = fit_whitening(z, eigenvalue_floor=1e-6)
    scales = np.linalg.norm(white.whiten, axis=0)  # one over the standard deviations
    assert (np.diff(scales) >= 0).all()
    flipped = fit_whitening(z[::-1].copy(), eigenvalue_floor=1e-6)
    np.testing.assert_allclose(flipped.whiten, white.whiten, rtol=1e-8)


def test_one_dimension() -> None:
    white = fit_whitening(latents(d=1), eigenvalue_floor=1e-6)
    assert white.whiten.shape == (1, 1)
    assert white.whiten[0, 0] > 0


def test_a_dead_direction_names_the_variances_and_the_remedy() -> None:
    z = latents()
    z[:, 2] = z[:, 0] - 2.0 * z[:, 1]
    with pytest.raises(ValueError, match=r"d = 3 is larger than the data can carry.*system\.d=2"):
        fit_whitening(z, eigenvalue_floor=1e-6)
    with pytest.raises(ValueError, match="larger than the data can carry"):
        fit_whitening(np.ones((50, 2)), eigenvalue_floor=1e-6)


def test_non_finite_latents_are_refused() -> None:
    z = latents()
    z[3] = np.nan
    with pytest.raises(ValueError, match="1 of them not finite"):
        fit_whitening(z, eigenvalue_floor=1e-6)
