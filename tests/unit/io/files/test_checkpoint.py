"""Checkpoints: only a whole one of the same run is gone on from."""

import logging
from pathlib import Path
from typing import NamedTuple

import pytest
import torch

from lagsplat.io.files.checkpoint import (
    load_checkpoint,
    load_training_state,
    save_checkpoint,
    save_training_state,
)


class Point(NamedTuple):
    """A point of a training curve."""

    step: int
    loss: float


def test_a_state_comes_back_to_the_run_that_saved_it(tmp_path: Path) -> None:
    path = tmp_path / "below" / "state.pt"
    assert load_checkpoint(path, identity="a") is None
    save_checkpoint(path, {"weight": torch.arange(3.0), "step": 7}, identity="a")
    state = load_checkpoint(path, identity="a")
    assert state is not None
    assert state["step"] == 7
    assert torch.equal(state["weight"], torch.arange(3.0))
    assert [file.name for file in path.parent.iterdir()] == ["state.pt"]


def test_another_run_and_a_damaged_file_are_ignored(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "state.pt"
    save_checkpoint(path, {"step": 7}, identity="a")
    with caplog.at_level(logging.WARNING):
        assert load_checkpoint(path, identity="b") is None
        path.write_bytes(path.read_bytes()[:40])
        assert load_checkpoint(path, identity="a") is None
        save_checkpoint(path, {"weight": torch.ones(100)}, identity="a")
        content = bytearray(path.read_bytes())
        content[len(content) // 2] ^= 1
        path.write_bytes(content)
        assert load_checkpoint(path, identity="a") is None
    assert "its checksum differs" in caplog.text
    assert "other settings" in caplog.text
    assert "cannot be read" in caplog.text


def test_a_training_run_goes_on_from_the_last_point_of_its_curve(tmp_path: Path) -> None:
    def start() -> tuple[torch.nn.Module, torch.optim.Optimizer]:
        model = torch.nn.Linear(2, 1)
        return model, torch.optim.Adam(model.parameters())

    path, (model, optimizer) = tmp_path / "state.pt", start()
    assert load_training_state(path, model, optimizer, Point, identity="a") == []
    model(torch.ones(2)).backward()
    optimizer.step()
    save_training_state(path, model, optimizer, [Point(1, 0.5), Point(2, 0.25)], identity="a")
    other, other_optimizer = start()
    curve = load_training_state(path, other, other_optimizer, Point, identity="a")
    assert curve == [Point(1, 0.5), Point(2, 0.25)]
    assert torch.equal(other.weight, model.weight)
    assert other_optimizer.state_dict()["state"][0]["step"] == 1


def test_without_a_path_nothing_is_kept() -> None:
    model = torch.nn.Linear(2, 1)
    optimizer = torch.optim.Adam(model.parameters())
    save_training_state(None, model, optimizer, [Point(1, 0.5)], identity="a")
    assert load_training_state(None, model, optimizer, Point, identity="a") == []
