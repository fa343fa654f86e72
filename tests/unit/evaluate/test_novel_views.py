"""Views are scored camera by camera, trained instants apart from the rest, holes left out."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.evaluate.novel_views import draw_novel_view, score_novel_views
from lagsplat.io.recording.recording import Recording
from lagsplat.report.figures.model_comparison import draw_novel_views
from lagsplat.stage1.autoencoder import Autoencoder, encode_frames
from lagsplat.stage1.gaussian_initialization import initialize_autoencoder
from lagsplat.stage1.training_data import TrainingFrames
from lagsplat.views.novel import NovelViews
from tests.unit.stage1.problems import small_config
from tests.unit.stage1.solid import SUPERVISION, swinging_ball

INSTANTS, TRAIN = 6, 4


@pytest.fixture(scope="module")
def run() -> tuple[Autoencoder, Recording, NovelViews]:
    frames, views = swinging_ball(INSTANTS)
    recording = Recording(
        frames=frames,
        time_s=np.arange(INSTANTS) / 30,
        inputs=np.zeros((INSTANTS, 0)),
        input_names=(),
        input_units=(),
        meta={"origin": "simulated"},
        n_train=TRAIN,
    )
    footage = TrainingFrames(frames, novel=views, supervision=SUPERVISION)
    return initialize_autoencoder(footage, small_config(n_gaussians=80), seed=0)[0].eval(), recording, views


def as_drawn(run: tuple[Autoencoder, Recording, NovelViews]) -> NovelViews:
    """Views that hold, to rounding, what the decoder draws."""
    autoencoder, recording, views = run
    z = encode_frames(autoencoder, recording.frames)
    pictures = [draw_novel_view(autoencoder, z, views.space.seen_by(camera)) for camera in views.cameras]
    return replace(views, images=np.round(255 * np.stack(pictures, 1)).clip(0, 255).astype(np.uint8))


def test_views_as_drawn_are_right_to_rounding_and_others_are_not(run) -> None:
    autoencoder, recording, views = run
    exact = score_novel_views(autoencoder, recording, as_drawn(run))
    assert exact["held_out"]["train"] > 55
    assert exact["seen"]["rest"] > 55
    assert (exact["held_out"]["cameras"], exact["seen"]["cameras"]) == (2, 3)
    true = score_novel_views(autoencoder, recording, views)
    assert true["held_out"]["train"] < 40
    assert set(true["per_camera"]) == set(views.names)


def test_errors_fall_where_they_belong(run) -> None:
    autoencoder, recording, _ = run
    spoilt = as_drawn(run)
    spoilt.images[TRAIN:, -1] = 0  # the last held-out camera, at the instants that were not trained on
    told = score_novel_views(autoencoder, recording, spoilt)
    assert told["held_out"]["train"] > 55
    assert told["held_out"]["rest"] < 55
    assert told["seen"]["rest"] > 55


def test_holes_do_not_count(run) -> None:
    autoencoder, recording, _ = run
    holed = as_drawn(run)
    holed.images[:, :, :, :5] = 0
    cover = np.full(holed.images.shape[:4], 255, np.uint8)
    assert score_novel_views(autoencoder, recording, holed)["held_out"]["train"] < 40
    cover[:, :, :, :5] = 0
    assert score_novel_views(autoencoder, recording, replace(holed, cover=cover))["held_out"]["train"] > 55


def test_the_figure_shows_held_out_cameras(run) -> None:
    figure = draw_novel_views(*run, title="toy")
    titles = [axis.get_title() for axis in figure.axes if axis.get_title()]
    assert len(titles) == 6
    assert "(train)" in titles[0]
    assert "(held out)" in titles[-1]
    assert torch.is_grad_enabled()
