"""Checkpoints: only a whole one of the same run is gone on from."""

import logging
from pathlib import Path

import pytest
import torch

from lagsplat.io.files.checkpoint import load_checkpoint, save_checkpoint


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
