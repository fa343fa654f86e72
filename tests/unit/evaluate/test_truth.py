"""Learned physics against the truth: two oscillations whose answers are known in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.evaluate.evaluate import make_integrator
from lagsplat.evaluate.free_motion import compare_decay, compute_linear_modes, cut_free_windows
from lagsplat.evaluate.protocol import select_held_out
from lagsplat.evaluate.truth import AT_REST, LINEARISED, ROLLOUT, compare_with_truth, fit_polynomial
from lagsplat.systems.truth import Truth
from tests.unit.evaluate import tiny_run
from tests.unit.evaluate.stand_ins import settings

N, SPLIT, DT_S = 1200, 600, tiny_run.DT_S
TRUE_HZ, TRUE_RATE, REST = 1.9, 0.4, np.array([0.3, -0.2])


def swing(frequency_hz: float, rate_per_s: float, phase: float) -> np.ndarray:
    """A free decay that starts anew at the split."""
    time_s = DT_S * (np.arange(N) % SPLIT)
    return np.exp(-rate_per_s * time_s) * np.cos(2 * np.pi * frequency_hz * time_s + phase)


@pytest.fixture(scope="module")
def known():
    """Latents that are a curved image of two true angles, both of which swing freely."""
    states = REST + np.stack([swing(TRUE_HZ, TRUE_RATE, 0.0), swing(4.1, 0.9, 1.0)], axis=1)
    a, b = (states - REST).T
    film = tiny_run.recording()
    chart = tiny_run.chart(tiny_run.autoencoder(), film)
    latents = np.stack([a + 0.1 * b + 0.1 * a**2, b - 0.1 * a], axis=1)
    chart = replace(
        chart,
        latents=latents,
        inputs=np.zeros((N, 0)),
        time_s=DT_S * np.arange(N),
        n_train=SPLIT,
        segments=((0, SPLIT), (SPLIT, N)),
        metric=np.eye(2),
    )
    frequencies, rates = np.array([TRUE_HZ, 4.1]), np.array([TRUE_RATE, 0.9])
    truth = Truth(
        coordinates=("a [rad]", "b [rad]"),
        states=states,
        velocities=np.zeros((N, 2)),
        pressures=np.zeros((N, 0)),
        forces=np.zeros((N, 2)),
        kinetic_energy=np.zeros(N),
        potential_energy=np.zeros(N),
        mass_frames=np.zeros(0, dtype=np.int64),
        mass_matrices=np.zeros((0, 2, 2)),
        rest=REST,
        natural_frequencies_hz=frequencies,
        damped_frequencies_hz=frequencies,
        decay_rates_per_s=rates,
        damping_ratios=np.zeros(2),
    )
    return chart, truth


def compared(chart, truth, *, frequency_hz: float = 2.0):
    law = tiny_run.lagrangian(n_inputs=0, frequency_hz=frequency_hz)
    windows = cut_free_windows(select_held_out(chart, settings()), make_integrator(law), settings())
    metrics = {"damping": compare_decay(*windows), "linear_modes": compute_linear_modes(law)}
    return by_place(compare_with_truth(metrics, truth, chart, law)["rows"])


def by_place(rows: list[dict]) -> dict[tuple, dict]:
    """Rows by quantity, source, and mode or coordinate; none is of a mean pressure."""
    assert {row["state"] for row in rows} <= {AT_REST, None}
    return {(row["quantity"], row["source"], row["mode"] or row["coordinate"]): row for row in rows}


def test_frequency_and_decay_of_every_excited_mode(known):
    rows = compared(*known)
    slow = rows["frequency", ROLLOUT, 1]
    assert slow["unit"] == "Hz"
    assert slow["learned"] == pytest.approx(2.0, rel=0.01)
    assert slow["truth"] == pytest.approx(TRUE_HZ, rel=1e-3)
    assert slow["encoded"] == pytest.approx(TRUE_HZ, rel=0.01)
    assert slow["error"] == pytest.approx(2.0 / TRUE_HZ - 1, abs=0.01)
    decay = rows["decay rate", LINEARISED, 1]
    assert (decay["learned"], decay["truth"]) == pytest.approx((tiny_run.RATE_PER_S, TRUE_RATE), rel=1e-6)
    assert rows["frequency", LINEARISED, 2]["truth"] == 4.1


def test_one_learned_oscillation_stands_for_one_true_mode_only(known):
    """Both coordinates of the law oscillate alike, so that its rollout shows a single frequency."""
    found = [compared(*known)["frequency", ROLLOUT, n]["learned"] for n in (1, 2)]
    assert found[0] == pytest.approx(2.0, rel=0.01)
    assert found[1] is None or abs(found[1] - 2.0) > 0.1


def test_what_is_not_excited_is_not_compared(known):
    chart, truth = known
    still = replace(truth, states=truth.states.copy())
    still.states[SPLIT:, 1] = REST[1]
    assert 2 not in {place[-1] for place in compared(chart, still)}


def test_the_equilibrium_is_read_in_true_coordinates(known):
    rows = compared(*known)
    for name, rest in zip(("a", "b"), REST, strict=True):
        row = rows["equilibrium", "law", name]
        assert row["unit"] == "rad"
        # the latents vanish where the angles rest, and the law rests at the origin
        assert row["learned"] == pytest.approx(rest, abs=0.02)
        assert row["truth"] == rest
        assert row["residual"] < 0.05
    chart, truth = known
    moved = replace(truth, rest=REST + np.array([0.5, 0.0]))
    row = compared(chart, moved)["equilibrium", "law", "a"]
    assert row["error"] == pytest.approx(0.5 / truth.states[:, 0].std(), rel=0.05)


def test_without_free_motion_the_law_alone_is_compared(known):
    chart, truth = known
    law = tiny_run.lagrangian(n_inputs=0)
    metrics = {"damping": {"windows": []}, "linear_modes": compute_linear_modes(law)}
    found = by_place(compare_with_truth(metrics, truth, chart, law)["rows"])
    assert found["frequency", ROLLOUT, 1]["learned"] is None
    assert found["frequency", LINEARISED, 1]["error"] == pytest.approx(2 / 1.9 - 1, rel=1e-3)


def test_modes_at_a_rest_state_far_from_the_data_are_extrapolated(known):
    chart, truth = known
    place = ("frequency", LINEARISED, 1)
    assert compared(chart, truth)[place]["extrapolated"] is False
    rows = compared(replace(chart, latents=chart.latents + 10.0), truth)
    assert rows[place]["extrapolated"] is True
    assert rows["equilibrium", "law", "a"]["extrapolated"] is None


def test_the_truth_of_another_recording_is_refused(known):
    chart, truth = known
    short = replace(truth, states=truth.states[:-1])
    with pytest.raises(ValueError, match="1199 states and the chart 1200"):
        compared(chart, short)


def test_a_cubic_is_found_and_a_still_coordinate_does_no_harm():
    rng = np.random.default_rng(0)
    q = rng.normal(size=(300, 3)) * [1.0, 0.5, 0.0]

    def true(points):
        x, y, _ = points.T
        return np.stack([1 + x - 0.5 * x**2 * y, y**3 + x * y], axis=1)

    predict = fit_polynomial(q, true(q))
    fresh = rng.normal(size=(20, 3)) * [1.0, 0.5, 0.0]
    assert predict(fresh) == pytest.approx(true(fresh), abs=1e-4)
