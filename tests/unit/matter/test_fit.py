"""Bodies are found in painted films, and move as they were painted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.integrate import quad

from lagsplat.matter.config import MatterConfig
from lagsplat.matter.field import BodyReport, MatterField, MatterReport, load_matter, save_matter
from lagsplat.matter.fit import fit_matter
from lagsplat.matter.registration import TUNING
from tests.unit.matter.films import Body, film, make_bending_body, make_rigid_body

CONFIG = MatterConfig(frames=160, latent_degree=None, bending=2, bodies=3)
HEIGHT, WIDTH, N = 44, 48, 220


def whitened(d: int, seed: int = 0) -> np.ndarray:
    """States of a free motion of several frequencies, whitened."""
    time = np.linspace(0.0, 1.0, N)
    rng = np.random.default_rng(seed)
    q = np.stack([np.sin(2 * np.pi * (7.3 + 4.1 * i) * time + rng.uniform(0, 6)) for i in range(d)], 1)
    return (q - q.mean(0)) / q.std(0)


def measure(matter: MatterField, body: Body, states: np.ndarray) -> tuple[float, float]:
    """Error of the places of the points that a body covers [px, rms], and the share of it that is found."""
    rows, columns = np.meshgrid(np.arange(HEIGHT) + 0.5, np.arange(WIDTH) + 0.5, indexing="ij")
    every = np.stack([columns.ravel(), rows.ravel()], 1)
    own = body.covers(matter.points.numpy())
    places = matter.carry(torch.from_numpy(states))[:, own].numpy()
    true = np.stack([body.carry(matter.points.numpy()[own], q) for q in states])
    return float(np.sqrt(np.mean((places - true) ** 2))), own.sum() / body.covers(every).sum()


def swing(q: np.ndarray) -> tuple[np.ndarray, float]:
    return np.array([4.0 * q[0], 0.6 * q[0] ** 2]), 0.2 * q[0]


def test_a_rigid_body_is_found_with_its_arcs() -> None:
    q = whitened(1)
    body = make_rigid_body(swing, (24.0, 22.0), (9.0, 7.0), 1)
    matter, report = fit_matter(film([body], q, height=HEIGHT, width=WIDTH), q, CONFIG)
    assert [each.bending for each in report.bodies] == [0]
    error, found = measure(matter, body, q)
    assert error < 0.1
    assert found > 0.9
    assert len(matter.points) < 1.15 * 18 * 14
    still = matter.jacobian(torch.zeros(1).double()).numpy()[..., 0]
    away = matter.points.numpy() - [24.0, 22.0]
    true = np.array([4.0, 0.0]) + 0.2 * np.stack([-away[:, 1], away[:, 0]], 1)
    assert np.linalg.norm(still - true) < 0.03 * np.linalg.norm(true)
    assert not report.warnings
    (motion,) = matter.bodies
    deviations = torch.stack(motion.deviations)
    assert len(deviations) == 3
    assert (
        0.0
        < float(deviations.square().sum(0).sqrt()[0].max())
        < 0.02 * float(motion.coefficients[0].abs().max())
    )


def test_a_body_that_bends_is_no_rigid_one() -> None:
    q = whitened(2)
    body = make_bending_body(2)
    matter, report = fit_matter(film([body], q, height=HEIGHT, width=WIDTH), q, CONFIG)
    assert report.bodies[0].bending == 2
    error, found = measure(matter, body, q)
    assert error < 0.2
    assert found > 0.85


@pytest.mark.parametrize("bending", [0, pytest.param(2, marks=pytest.mark.campaign)])
def test_two_bodies_with_a_coordinate_each_are_two_bodies(bending: int) -> None:
    q = whitened(2)
    left = make_rigid_body(lambda q: (np.array([0.0, 3.0 * q[0]]), 0.1 * q[0]), (13.0, 22.0), (7.0, 8.0), 3)
    right = make_rigid_body(lambda q: (np.array([0.5 * q[1], -2.5 * q[1]]), 0.0), (35.0, 22.0), (6.0, 6.0), 4)
    config = replace(CONFIG, bending=bending)
    matter, report = fit_matter(film([left, right], q, height=HEIGHT, width=WIDTH), q, config)
    assert [each.bending for each in report.bodies] == [0, 0]
    for body in (left, right):
        error, found = measure(matter, body, q)
        assert error < 0.15
        assert found > 0.8


def test_a_still_film_and_a_short_one_are_refused() -> None:
    q = whitened(1)
    body = make_rigid_body(swing, (24.0, 22.0), (9.0, 7.0), 1)
    still = film([body], np.zeros_like(q), height=HEIGHT, width=WIDTH)
    with pytest.raises(ValueError, match="no matter to register"):
        fit_matter(still, q, CONFIG)
    with pytest.raises(ValueError, match="needs more than 6 frames near the mean state"):
        fit_matter(still[:6], q[:6], CONFIG)


def test_states_that_tell_nothing_of_the_film_are_refused() -> None:
    q = whitened(1)
    body = make_rigid_body(swing, (24.0, 22.0), (9.0, 7.0), 1)
    frames = film([body], q, height=HEIGHT, width=WIDTH)
    with pytest.raises(ValueError, match="no body was found along whose motion"):
        fit_matter(frames, np.random.default_rng(0).permutation(q), CONFIG)


def test_a_field_comes_back_from_its_file(tmp_path: Path) -> None:
    q = whitened(1)
    body = make_rigid_body(swing, (24.0, 22.0), (9.0, 7.0), 1)
    config = MatterConfig(frames=60, latent_degree=2, bending=1, bodies=1)
    matter, report = fit_matter(film([body], q, height=HEIGHT, width=WIDTH), q, config)
    save_matter(tmp_path / "matter.safetensors", matter, {"made": "here"}, report)
    again, header = load_matter(tmp_path / "matter.safetensors")
    states = torch.from_numpy(q)
    assert torch.equal(again.carry(states), matter.carry(states))
    for one, other in zip(again.bodies[0].deviations, matter.bodies[0].deviations, strict=True):
        assert torch.equal(one, other)
    assert header["report"]["bodies"][0]["pixels"] == len(matter.points)
    assert header["made"] == "here"


def test_a_report_warns_of_bodies_that_keep_no_colour() -> None:
    poor = BodyReport(pixels=40, losses=[0.6], bending=0, scale=0.1, explained=0.3)
    report = MatterReport([poor], moving=100, unexplained=20, frames=50, noise=0.01, wall_s=1.0)
    assert "saves 30% of the loss" in report.warnings[0]
    assert "20 of 100 moving pixels" in report.warnings[1]


def test_the_loss_is_95_percent_efficient_for_gaussian_noise() -> None:
    """Efficiency of an M-estimator: ``E[psi']^2 / E[psi^2]`` (Huber, Robust Statistics, 1981)."""

    def density(r: float) -> float:
        return float(np.exp(-0.5 * r**2) / np.sqrt(2 * np.pi))

    def share(r: float) -> float:
        return TUNING**2 / (TUNING**2 + r**2)

    slope = quad(lambda r: (share(r) ** 2 * (1 - 4 * (1 - share(r)))) * density(r), -9, 9)[0]
    square = quad(lambda r: (r * share(r) ** 2) ** 2 * density(r), -9, 9)[0]
    assert slope**2 / square == pytest.approx(0.95, abs=1e-3)
