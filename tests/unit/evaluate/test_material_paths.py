"""Paths of material points, of a plate whose motion is known, and their figure."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.evaluate.material_paths import MaterialPaths, follow_material_points
from lagsplat.matter.body_motion import make_body_at_rest
from lagsplat.matter.field import MatterField
from lagsplat.monomials import make_wide_ball
from lagsplat.report.figures.matter import draw_matter
from lagsplat.systems.pushable import Pushable
from lagsplat.systems.truth import Truth
from tests.unit.forces.rocking import rocking

CENTER = np.array([16.0, 12.0])
GRID = np.stack(np.meshgrid(np.arange(10.5, 22.0), np.arange(7.5, 17.0)), -1).reshape(-1, 2)
TURN = 0.2  # of the plate per true unit [rad]; a latent is 2 true units


def turned(states: np.ndarray) -> np.ndarray:
    """Places of the points of the plate, which turns about `CENTER`."""
    angle = TURN * states[:, 0]
    away = GRID[::7] - CENTER
    x = np.outer(np.cos(angle), away[:, 0]) - np.outer(np.sin(angle), away[:, 1])
    y = np.outer(np.sin(angle), away[:, 0]) + np.outer(np.cos(angle), away[:, 1])
    return CENTER + np.stack([x, y], 2)


def system() -> Pushable:
    """The plate; nothing here needs its equations of motion."""

    def still(*_: np.ndarray) -> np.ndarray:
        return np.zeros(1)

    return Pushable(np.zeros(1), still, still, lambda q: np.eye(1), turned, np.full(len(GRID[::7]), 1.0))


def plate(factor: float) -> MatterField:
    """The plate as a field of matter, which turns by ``factor`` times the true angle."""
    points = torch.from_numpy(GRID)
    motion = make_body_at_rest(points, make_wide_ball(1), bending=0)
    motion.coefficients[0, 2] = factor * 2.0 * TURN
    motion = replace(motion, center=torch.from_numpy(CENTER))
    return MatterField((motion,), points, torch.zeros(len(points)).long())


def follow(matter: MatterField) -> MaterialPaths:
    """Paths of the material points of the plate, found by a field."""
    chart = replace(rocking().chart, n_train=40)
    nothing, states = np.zeros(0), 2.0 * chart.latents
    names = ("kinetic_energy", "potential_energy", "natural_frequencies_hz", "damped_frequencies_hz")
    empty = dict.fromkeys((*names, "decay_rates_per_s", "damping_ratios"), nothing)
    truth = Truth(
        coordinates=("angle [rad]",),
        states=states,
        velocities=states,
        pressures=np.zeros((len(states), 0)),
        forces=states,
        mass_frames=np.zeros(0, dtype=np.int64),
        mass_matrices=np.zeros((0, 1, 1)),
        rest=np.zeros(1),
        **empty,
    )
    return follow_material_points(matter, chart, system(), truth)


@pytest.mark.parametrize("factor", [1.0, 0.9])
def test_the_error_of_a_path_is_the_share_that_it_is_short(factor: float) -> None:
    paths = follow(plate(factor))
    numbers = paths.measure()
    assert numbers["known"] == 1.0
    assert numbers["path"] == pytest.approx(1.0 - factor, abs=5e-3)
    assert numbers["direction_deg_p90"] < 0.01
    assert numbers["shape"] < 1e-3
    assert paths.found_jacobian == pytest.approx(factor * paths.jacobian, abs=1e-3)
    figure = draw_matter(plate(factor), np.full((24, 32, 3), 0.5), paths, title="A plate")
    assert figure.axes[0].get_title() == "bodies: rigid, 120 px"
    assert "held-out paths" in figure.axes[2].get_title()


def test_points_far_from_all_matter_are_not_known() -> None:
    far = MatterField(plate(1.0).bodies, torch.from_numpy(GRID[:1]) + 100.0, torch.zeros(1).long())
    paths = follow(far)
    assert np.isnan(paths.found).all()
    assert paths.measure() == {
        "known": 0.0,
        "path": None,
        "direction_deg": None,
        "direction_deg_p90": None,
        "shape": None,
    }
    figure = draw_matter(far, np.full((24, 32, 3), 0.5), paths, title="Of a film")
    assert figure.axes[2].get_title() == "held-out paths"
    assert len(draw_matter(far, np.full((24, 32, 3), 0.5), None, title="Of a film").axes) == 2
