"""A push that nobody logged, in the recordings that a sim is found from: the law must not bend to it."""

import numpy as np
import pytest

from lagsplat.diagnose.identification.estimated_simulator import estimate_simulator
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.mechanisms import Duffing, film
from tests.unit.diagnose.toys import settings

PUSHED_S = (9.1, 9.4)
MECHANISM = Duffing()


def drive(t: np.ndarray) -> np.ndarray:
    return 6.0 * np.sin(2.0 * np.pi * 0.37 * t) + 5.0 * np.sin(2.0 * np.pi * 1.3 * t + 1.0)


def driven(*, push: float) -> Trajectory:
    """20 s of a spring whose input is logged, and a push of this force that is not."""

    def force(t: float, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.array([push if PUSHED_S[0] < t < PUSHED_S[1] else 0.0])

    return film(MECHANISM, 20.0, start=(0.4,), inputs=drive, force=force, noise=0.01, finer=2)


@pytest.mark.parametrize("push", [12.0, 80.0])
def test_the_law_is_found_without_the_stretch_in_which_something_else_acted(push: float) -> None:
    sim = estimate_simulator([driven(push=push)], settings())
    assert sim.misfit < 1.5
    assert 1 <= len(sim.outlier_spans) <= 2
    assert min(one.start_s for one in sim.outlier_spans) <= PUSHED_S[0]
    assert max(one.stop_s for one in sim.outlier_spans) >= PUSHED_S[1]
    q, v, u = (np.random.default_rng(0).uniform(-1.0, 1.0, (50, 1)) * size for size in (0.4, 2.5, 8.0))
    true = MECHANISM.acceleration(q, v, u)
    assert np.std(sim.model.acceleration(q, v, u) - true) < 0.05 * np.std(true)


def test_nothing_is_left_out_where_nothing_else_acted() -> None:
    assert estimate_simulator([driven(push=0.0)], settings()).outlier_spans == ()


def test_a_law_that_is_wrong_all_the_time_keeps_all_its_recording() -> None:
    """Its input is not logged at all."""
    motion = driven(push=0.0)
    bare = Trajectory(time_s=motion.time_s, q=motion.q, u=np.zeros((motion.n, 0)), source="film")
    sim = estimate_simulator([bare], settings())
    assert sim.misfit > 10.0
    assert sim.outlier_spans == ()
