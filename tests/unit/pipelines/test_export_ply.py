"""A state as a PLY shows, drawn by itself, what the run draws."""

from pathlib import Path

import numpy as np
import pytest
import torch

from lagsplat.io.files.ply import read_cloud
from lagsplat.pipelines.export import export_ply
from lagsplat.runs.run import FittedRun, choose_state
from lagsplat.splat.gaussians import GaussianSlice
from lagsplat.splat.image_model import rasterize
from lagsplat.splat.projection import make_view, project
from lagsplat.views.camera import center_camera, orbit_camera
from tests.unit.evaluate import tiny_run
from tests.unit.forces.rocking import rocking
from tests.unit.forces.solid import FOCAL, HEIGHT, WIDTH, turning


def drawn(path: Path, camera, height: int, width: int) -> torch.Tensor:
    """The picture that a viewer makes of a PLY, blending stored colours before black."""
    cloud = read_cloud(path)
    row, column = np.tril_indices(3)
    parts = (cloud.means[None], cloud.covariances()[:, row, column], cloud.opacities[None], cloud.colors)
    scene = GaussianSlice(
        *(torch.as_tensor(part, dtype=torch.float64) for part in parts), torch.zeros(3).double()
    )
    view = type(make_view([camera]))(*(part.double() for part in make_view([camera])))
    return rasterize(*project(scene, view, height=height, width=width), height=height, width=width)


@torch.no_grad()
def test_a_state_in_space_looks_the_same_from_every_side(tmp_path: Path) -> None:
    held = turning()
    front = center_camera(np.eye(3), np.zeros(3), focal=FOCAL, height=HEIGHT, width=WIDTH)
    for q in (np.zeros(1), np.array([0.7])):
        export_ply(held.autoencoder, held.chart, q, tmp_path / "a.ply")
        for yaw in (0.0, 15.0):
            ours = held.autoencoder.decode(
                torch.as_tensor(held.chart.to_raw(q[None]), dtype=torch.float32),
                view=make_view([orbit_camera(front, FOCAL, yaw_deg=yaw, pitch_deg=0.0)]),
            )
            theirs = drawn(
                tmp_path / "a.ply", orbit_camera(front, 1.0, yaw_deg=yaw, pitch_deg=0.0), HEIGHT, WIDTH
            )
            torch.testing.assert_close(theirs.float(), ours, atol=2e-3, rtol=0)


@torch.no_grad()
def test_a_choose_state_the_picture_is_a_plane_in_the_same_order(tmp_path: Path) -> None:
    held = rocking()
    model = held.autoencoder
    with torch.no_grad():
        model.gaussians.shape_log_diagonal.fill_(0.7)
        model.gaussians.color_logit.normal_()
    export_ply(model, held.chart, np.zeros(1), tmp_path / "a.ply")
    front = center_camera(
        np.eye(3), np.zeros(3), focal=float(model.width), height=model.height, width=model.width
    )
    ours = model.decode(torch.zeros(1, 1))
    torch.testing.assert_close(
        drawn(tmp_path / "a.ply", front, model.height, model.width).float(), ours, atol=4e-3, rtol=0
    )


def test_states_that_are_none_are_refused(tmp_path: Path) -> None:
    held = turning()
    for q, message in (
        (np.zeros(2), "not one of 1 finite coordinates"),
        (np.array([np.nan]), "not one of 1 finite"),
        (np.array([500.0]), "no Gaussian is present"),
    ):
        with pytest.raises(ValueError, match=message):
            export_ply(held.autoencoder, held.chart, q, tmp_path / "a.ply")
    assert not (tmp_path / "a.ply").exists()


def test_a_command_names_a_frame_numbers_or_rest() -> None:
    film, model = tiny_run.recording(60, tail=20), tiny_run.autoencoder()
    chart = tiny_run.chart(model, film)
    run = FittedRun(film, model, chart, tiny_run.lagrangian())
    np.testing.assert_array_equal(choose_state(run, None, None), chart.rest)
    np.testing.assert_array_equal(choose_state(run, "7", None), chart.latents[7])
    np.testing.assert_array_equal(choose_state(run, None, "0.5,-1"), [0.5, -1.0])
    for frame, q in (("60", None), ("x", None), (None, "a,b"), ("1", "0")):
        with pytest.raises(ValueError, match="frame="):
            choose_state(run, frame, q)
