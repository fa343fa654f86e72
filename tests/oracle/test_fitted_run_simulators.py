"""Fitted runs as sims: their Lagrangian in seconds, their latents as motions."""

from pathlib import Path

import numpy as np
import pytest
import torch

from lagsplat.chart.chart import Chart
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.simulators.fitted_run import (
    convert_to_latents,
    convert_to_law,
    linearize_law_coordinates,
    project_run,
    read_chart_trajectory,
)
from lagsplat.pipelines.apply_diagnosis import sample_simulator
from lagsplat.stage2.fit import save_dynamics
from lagsplat.stage2.lagrangian import Lagrangian
from tests.stage2_problems import random_lagrangian

UNIT = 0.25


def lagrangian(d: int, n_u: int, **changes: object) -> Lagrangian:
    made = random_lagrangian(d, n_u, 3, amount=0.05, map_degree=2, **changes)
    made.time_unit_s.fill_(UNIT)
    return made


def region(d: int, n_u: int) -> OperatingRegion:
    rng = np.random.default_rng(0)
    return OperatingRegion(
        rng.uniform(-1, 1, (500, d)), rng.uniform(-4, 4, (500, d)), rng.uniform(0, 1, (500, n_u))
    )


@torch.no_grad()
def accelerate_per_second(made: Lagrangian, where: OperatingRegion) -> np.ndarray:
    """The Lagrangian's own acceleration, asked over latents in its unit of time, over its coordinates in
    seconds."""
    x, w, u = (torch.as_tensor(values) for values in (where.q, UNIT * where.v, where.u))
    if made.coordinates is None:
        return made.acceleration(x, w, u).numpy() / UNIT**2
    q, v = made.coordinates.pull(x, w)
    jacobian = made.coordinates.evaluate(q)[1]
    turned = (jacobian @ made.acceleration(q, v, u)[:, :, None])[:, :, 0]
    return (turned + made.coordinates.measure_bending(q, v)).numpy() / UNIT**2


@pytest.mark.parametrize(
    ("d", "n_u", "terms", "allowed"),
    [
        (1, 1, "networks", 0.02),
        (2, 2, "networks", 0.02),
        (2, 0, "networks", 0.02),
        (2, 1, "polynomial", 1e-6),
        (4, 1, "polynomial", 1e-6),
    ],
)
def test_a_run_accelerates_as_its_lagrangian(d: int, n_u: int, terms: str, allowed: float) -> None:
    made, where = lagrangian(d, n_u, terms=terms), region(d, n_u)
    found = project_run(made, where, what="run")
    truth = accelerate_per_second(made, where)
    known = np.isfinite(truth).all(axis=1)  # where the random map of coordinates can be inverted
    wrong = found.model.acceleration(where.q, where.v, where.u)[known] - truth[known]
    assert found.error < allowed
    assert known.mean() > 0.9
    assert np.sqrt(np.mean(wrong**2)) < allowed * np.sqrt(np.mean(truth[known] ** 2))


@pytest.mark.parametrize("terms", ["networks", "polynomial"])
def test_latents_are_found_again_from_the_coordinates_of_the_law(terms: str) -> None:
    made, q = lagrangian(2, 1, terms=terms), region(2, 1).q
    x = convert_to_law(made, q)
    assert (x is q) == (terms == "networks")
    np.testing.assert_allclose(convert_to_latents(made, x), q, atol=1e-9)


def test_along_the_straight_coordinate_damping_does_not_depend_on_the_place() -> None:
    made, where = lagrangian(1, 1, terms="polynomial"), region(1, 1)
    s = convert_to_law(made, where.q)
    np.testing.assert_allclose(convert_to_latents(made, s), where.q, atol=1e-9)
    model = project_run(made, OperatingRegion(s, where.v, where.u), what="run").model
    straight = [field(s)[:, 0, 0] for field in (model.mass_at, model.damping_at)]
    x = made.coordinates.evaluate(torch.as_tensor(where.q))[0]
    own = made.in_own_coordinates()
    bent = [field(x).detach().numpy()[:, 0, 0] for field in (own.mass, own.damping)]
    for along_s, along_x in zip(straight, bent, strict=True):
        # the floor of the matrices, which keeps them positive, is not of the frame
        assert np.ptp(along_s) / np.mean(along_s) < 0.2 * np.ptp(along_x) / np.mean(along_x)


@pytest.mark.parametrize(("d", "terms"), [(1, "polynomial"), (2, "polynomial"), (2, "networks")])
def test_velocities_go_into_the_coordinates_of_the_law(d: int, terms: str) -> None:
    made, q = lagrangian(d, 1, terms=terms), region(d, 1).q[5]
    at, slope = linearize_law_coordinates(made, q)
    np.testing.assert_allclose(at, convert_to_law(made, q[None])[0])
    moved = convert_to_law(made, (q + 1e-3 * np.ones(d))[None])[0]
    np.testing.assert_allclose(moved - at, 1e-3 * slope @ np.ones(d), rtol=2e-2, atol=1e-9)


def test_states_at_which_polynomials_are_clipped_do_not_bend_the_model() -> None:
    made, where = lagrangian(2, 1, terms="polynomial"), region(2, 1)
    assert made.energy is not None
    far = OperatingRegion(*(np.concatenate([part, part]) for part in (where.q, where.v, where.u)))
    far.q[-len(where.q) // 4 :] *= 2.0 * float(made.energy.ball[-1])
    assert project_run(made, far, what="run").error < 1e-6


def test_a_run_is_found_by_its_folder_and_must_fit(tmp_path: Path) -> None:
    made, where = lagrangian(1, 1), region(1, 1)
    save_dynamics(tmp_path / "dynamics.safetensors", made, {})
    found = sample_simulator(str(tmp_path), where)
    np.testing.assert_array_equal(found.model.potential, project_run(made, where, what="run").model.potential)
    with pytest.raises(ValueError, match=r"1 latent\(s\) and 1 input\(s\), but the recording 2 and 1"):
        project_run(made, region(2, 1), what="run")
    (tmp_path / "a.csv").write_text("t,q0\n0,0\n1,1\n")
    with pytest.raises(ValueError, match="is identified and not sampled"):
        sample_simulator(str(tmp_path / "a.csv"), where)


def chart() -> Chart:
    time = np.arange(30) / 60.0
    return Chart(
        mean=np.array([0.5]),
        whiten=np.array([[2.0]]),
        unwhiten=np.array([[0.5]]),
        metric=np.eye(1),
        metric_scale=1.0,
        latents=np.arange(30.0)[:, None],
        inputs=10.0 + np.arange(30.0)[:, None],
        time_s=time,
        rest=np.zeros(1),
        n_train=16,
        segments=((0, 10), (12, 24), (24, 30)),
        smoothing_frames=1.0,
        condition=1.0,
        intrinsic_dimension=1.0,
        refinement_steps=0,
        visibility_step=2e-2,
    )


def test_a_run_is_held_against_what_no_fit_saw() -> None:
    held = read_chart_trajectory(chart(), held_out=True)
    assert held.segments == ((0, 8), (8, 14))
    np.testing.assert_array_equal(held.q[:, 0], np.arange(16.0, 30.0))
    np.testing.assert_array_equal(held.u[:, 0], np.arange(26.0, 40.0))
    seen = read_chart_trajectory(chart(), held_out=False)
    assert seen.segments == ((0, 10), (10, 14))
    np.testing.assert_array_equal(seen.q[8:12, 0], [8.0, 9.0, 12.0, 13.0])
    np.testing.assert_allclose(seen.time_s[10], 12 / 60.0)
