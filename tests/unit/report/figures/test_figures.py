"""Figures of a run in miniature: drawn without a warning, and labelled with what they are of."""

from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from scipy.ndimage import gaussian_filter, shift

from lagsplat.evaluate.long_rollout import (
    FineDecoder,
    choose_figure_window,
    choose_inset,
    compute_long_rollout,
    estimate_shift,
)
from lagsplat.evaluate.protocol import select_held_out
from lagsplat.report.common.formatting import format_number
from lagsplat.report.common.style import save_figure
from lagsplat.report.figures.model_comparison import draw_reconstruction
from lagsplat.report.figures.rollout import draw_rollout
from lagsplat.report.figures.training_curves import (
    VISIBILITY,
    draw_curves,
    draw_latents,
    order_by_visibility,
)
from tests.unit.evaluate import tiny_run
from tests.unit.evaluate.stand_ins import settings

TITLE = "Rollout · toy arm · simulated recording · profile toy"


@pytest.fixture(scope="module")
def parts():
    film, model = tiny_run.recording(), tiny_run.autoencoder()
    return model, tiny_run.chart(model, film), tiny_run.lagrangian(), film


@pytest.fixture(scope="module")
def view(parts):
    return compute_long_rollout(*parts, settings(figure={"duration_s": 3.0}))


def texts(figure) -> str:
    return " | ".join(text.get_text() for text in figure.findobj(mpl.text.Text))


def save(figure, folder):
    """Both formats; nothing global has moved."""
    before = dict(mpl.rcParams)
    for suffix in ("png", "pdf"):
        save_figure(folder / f"a.{suffix}", figure)
    assert dict(mpl.rcParams) == before
    assert b"/Type3" not in (folder / "a.pdf").read_bytes()


def test_reconstruction(parts, tmp_path):
    model, _, _, film = parts
    figure = draw_reconstruction(model, film.part(300, 400), title=TITLE)
    save(figure, tmp_path)
    for part in (TITLE, "recorded", "rendered", "|error|", "worst", "MSE "):
        assert part in texts(figure)


def test_latents(parts, tmp_path):
    chart = parts[1]
    figure = draw_latents(chart, title=TITLE)
    save(figure, tmp_path)
    order, share = order_by_visibility(chart.metric)
    words = texts(figure)
    assert TITLE in words
    assert words.index(f"$q_{{{order[0] + 1}}}$") < words.index(f"$q_{{{order[1] + 1}}}$")
    assert "of visible motion" in words
    assert VISIBILITY in words
    assert share[0] >= share[1]
    assert share.sum() == pytest.approx(1.0)


def test_latents_without_inputs(parts, tmp_path):
    bare = replace(parts[1], inputs=np.zeros((600, 0)))
    assert len(draw_latents(bare, title=TITLE).axes) == 4


def test_rollout(view, tmp_path):
    figure = draw_rollout(view, title=TITLE)
    save(figure, tmp_path)
    words = texts(figure)
    for part in (
        TITLE,
        "encoded frames",
        "predicted",
        "recorded\n16×16, at 3.0 s",
        "256×256",
        "% of visible motion",
        "the whole clip is held out",
        VISIBILITY,
        "push",
        "inputs\n(N)",
        f"latent NRMSE {view.nrmse:.3f} over 3.0 s",
        "natural periods of 0.50 s",
        "in frames of 16×16",
        f"{format_number(view.images.inset.ratio)} × the local\nreconstruction error",
    ):
        assert part in words


def test_rollout_is_long_unanchored_and_starts_from_the_encoding(view):
    assert view.time_s[-1] == pytest.approx(3.0)
    # it starts from the smoothed encoding
    assert np.allclose(view.predicted[0], view.encoded[0], atol=0.1)
    assert view.images.at_encoded.shape == (256, 256, 3)
    assert view.lost_s is None


def test_rollout_crosses_the_boundary(parts, tmp_path):
    """600 frames of one clip, half of them held out; the last five seconds are drawn."""
    crossing = settings(figure={"start": "boundary", "duration_s": 7.0})
    view = compute_long_rollout(*parts, crossing)
    assert len(view.time_s) == 421
    assert view.held_s == pytest.approx((421 - 300) * tiny_run.DT_S)
    assert np.array_equal(view.encoded, parts[1].latents[179:])
    figure = draw_rollout(view, title=TITLE)
    save(figure, tmp_path)
    assert f"{view.held_nrmse:.3f} over the held-out 5.0 s (shaded)" in texts(figure)


@pytest.mark.parametrize(
    ("duration_s", "begin", "end"), [(100.0, 2, 600), (7.0, 179, 600), (3.0, 210, 391), (5.0, 150, 451)]
)
def test_the_boundary_is_in_the_figure(parts, duration_s, begin, end):
    """The two first frames of a clip are spent on the velocity of the third."""
    config = settings(figure={"start": "boundary", "duration_s": duration_s})
    stretch = choose_figure_window(parts[1], config)
    assert (stretch.start, stretch.stop) == (begin, end)
    assert stretch.boundary == 300 - begin


def test_an_unseen_clip_cannot_be_crossed_into(parts):
    clips = replace(parts[1], segments=((0, 300), (300, 600)))
    with pytest.raises(ValueError, match="use held_out"):
        choose_figure_window(clips, settings(figure={"start": "boundary"}))
    whole = choose_figure_window(clips, settings())
    assert (whole.offset, whole.start, whole.stop) == (300, 2, 300)
    assert whole.boundary == 0


def test_a_finer_decoder_draws_its_own_recording(parts):
    """Twice the resolution; the shift is still told in pixels that the latents were encoded at."""
    film = parts[3]
    larger = replace(film, frames=film.frames.repeat(2, axis=1).repeat(2, axis=2))
    finer = FineDecoder(tiny_run.autoencoder(side=32), larger)
    view = compute_long_rollout(*parts, settings(figure={"duration_s": 0.5}), fine=finer)
    assert view.images.recorded.shape == (32, 32, 3)
    assert view.images.scale == 16.0
    short = FineDecoder(finer.decoder, larger.part(0, 500))
    with pytest.raises(ValueError, match="500 frames and the recording 600"):
        compute_long_rollout(*parts, settings(figure={"duration_s": 0.5}), fine=short)


def test_latent_error_is_that_of_the_protocol(view, parts):
    """Over the stretch: rms in the metric, over that of the held-out states about their mean."""
    held = select_held_out(parts[1], settings())
    off = view.predicted - view.encoded
    error = np.einsum("ti,ij,tj->t", off, held.metric, off)
    about = held.latents - held.latents.mean(axis=0)
    scale = np.einsum("ti,ij,tj->t", about, held.metric, about)
    assert view.nrmse == pytest.approx(np.sqrt(error.mean() / scale.mean()))
    assert view.held_nrmse == view.nrmse


def test_rollout_is_cut_to_the_clip_and_shows_a_divergence(parts, tmp_path):
    model, chart, _, film = parts
    wild = tiny_run.lagrangian(frequency_hz=60.0)  # beyond the integrator's stability at this frame rate
    view = compute_long_rollout(model, chart, wild, film, settings())
    assert len(view.time_s) == 298
    assert view.lost_s is not None
    assert np.isnan(view.predicted[-1]).all()
    assert np.isfinite(view.images.at_predicted).all()
    figure = draw_rollout(view, title=TITLE)
    save(figure, tmp_path)
    assert f"diverged at {view.lost_s:.1f} s" in texts(figure)


def test_curves(tmp_path):
    curve = pd.DataFrame({"step": [1, 2, 3], "loss": [1.0, 0.1, 0.01], "mse": [1e-2, 0.0, 1e-4]})
    figure = draw_curves(curve, title=TITLE, columns=["loss", "mse"], labels={"mse": "MSE"}, unit="error")
    save(figure, tmp_path)
    assert "MSE, 1.0·10⁻⁴ in the end" in texts(figure)
    assert "training step, of 3" in texts(figure)
    save_figure(tmp_path / "b.pdf", figure)
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()
    with pytest.raises(ValueError, match="no column"):
        draw_curves(curve, title=TITLE, columns=["lost"], labels={}, unit="error")


def blob(row: float, column: float) -> np.ndarray:
    image = np.zeros((64, 64))
    image[20:44, 28:36] = 1.0
    return gaussian_filter(shift(image, (row, column), order=1), 1.5)


@pytest.mark.parametrize("moved", [(0.0, 0.0), (3.0, -2.0), (-0.5, 1.25)])
def test_shift_is_measured_below_a_pixel(moved):
    assert estimate_shift(blob(0, 0), blob(*moved)) == pytest.approx(moved, abs=0.25)


def test_no_structure_no_shift():
    assert estimate_shift(np.zeros((16, 16)), blob(0, 0)[:16, :16]) == (0.0, 0.0)


def test_inset_looks_at_what_moved():
    """Upper left something stands still; lower right the prediction has moved."""
    encoded = np.zeros((64, 64, 3))
    encoded[44:56, 40:48] = 1.0
    predicted = np.roll(encoded, 3, axis=1)
    encoded[4:16, 4:16] = predicted[4:16, 4:16] = 1.0
    inset = choose_inset(encoded, predicted, np.zeros((16, 16)))
    assert 44 <= inset.row + inset.side / 2 <= 56
    assert 36 <= inset.column + inset.side / 2 <= 56
    assert inset.shift_px == pytest.approx((0.0, 3.0), abs=0.6)


def test_inset_leaves_out_what_the_image_model_gets_wrong():
    """On the left both renders differ more, but there the render at the encoded state is wrong anyway."""
    encoded = np.zeros((64, 64, 3))
    encoded[24:40, 8:24] = 1.0
    encoded[24:40, 44:52] = 0.5
    predicted = np.roll(encoded, 2, axis=1)
    assert choose_inset(encoded, predicted, np.zeros((64, 64))).column < 20
    wrong = np.zeros((64, 64))
    wrong[20:44, 4:28] = 1.0
    inset = choose_inset(encoded, predicted, wrong)
    assert 40 <= inset.column + inset.side / 2 <= 56
    assert inset.ratio > 100
    window = (slice(inset.row, inset.row + inset.side), slice(inset.column, inset.column + inset.side))
    moved = np.abs(predicted - encoded)[window].mean()
    assert choose_inset(encoded, predicted, wrong + 0.01).ratio == pytest.approx(moved / 0.01)


def test_inset_of_a_good_forecast_is_on_the_object():
    """The renders differ by less than the image model errs, which is least on the background."""
    encoded = np.zeros((64, 64, 3))
    encoded[44:56, 40:48] = 1.0
    predicted = encoded + 0.01 * (np.roll(encoded, 3, axis=1) - encoded)
    wrong = 0.02 + 0.1 * encoded.mean(axis=2)
    inset = choose_inset(encoded, predicted, wrong)
    assert 44 <= inset.row + inset.side / 2 <= 56
    assert 36 <= inset.column + inset.side / 2 <= 56
