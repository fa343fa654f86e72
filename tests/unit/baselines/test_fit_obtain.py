"""A baseline by training and by published weights."""

import pytest
import torch

from lagsplat.baselines import released as publication
from lagsplat.baselines.fit import obtain_baseline
from lagsplat.config.schema import options
from tests.unit.baselines.problems import pushed_square, settings
from tests.unit.baselines.test_released import published


def test_a_training_tells_what_it_cost(tmp_path):
    train, config = pushed_square().split()[0], settings("koopman_deconv")
    baseline, story = obtain_baseline(train, config, seed=0, checkpoint=tmp_path / "state.pt", identity="a")
    assert baseline.architecture.dynamics == "koopman"
    assert (story["steps"], story["frames_seen"], story["weights"]) == (30, 240, None)
    assert story["wall_s"] == story["curve"][-1]["seconds"] > 0


def test_published_weights_take_the_place_of_a_training(tmp_path):
    path = tmp_path / "weights.pt"
    torch.save(published("koopman"), path)
    given = {"weights": str(path)}
    parts = {"seed": 0, "checkpoint": tmp_path / "state.pt", "identity": "a"}
    train = pushed_square().split()[0]
    baseline, story = obtain_baseline(train, settings("koopman_abcd", **given), **parts)
    assert baseline.architecture.d == 8
    assert (story["epoch"], story["steps"], story["curve"]) == (300, None, [])
    with pytest.raises(ValueError, match="koopman with abcd, but oscillators with abcd"):
        obtain_baseline(train, settings("osc_abcd", **given), **parts)


def test_every_choice_has_published_weights_of_both_arms():
    found = {(system, name) for system in ("krauss_1seg", "krauss_2seg") for name in options("baseline")}
    assert set(publication.RUNS) == set(publication.SHA256) == found
    assert publication.release_url("krauss_1seg", "osc_abcd").endswith(
        "/further/epoch_300/model_checkpoint.pt"
    )


def test_the_folder_of_a_download_is_the_one_that_weights_are_looked_for_in(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(
        publication, "download", lambda url, path, sha256: asked.append((url, sha256)) or path
    )
    paths = publication.fetch_weights(tmp_path)
    assert tmp_path / "krauss_2seg" / "osc_deconv.pt" in paths
    assert len({digest for _, digest in asked}) == len(paths) == 8
