"""Foreign lists of weights: read without running anything."""

from pathlib import Path

import pytest
import torch

from lagsplat.io.files.checkpoint import load_weights


class Runs:
    """Would print something when unpickled."""

    def __reduce__(self) -> tuple:
        return (print, ("run",))


def test_tensors_and_numbers_come_back(tmp_path: Path) -> None:
    torch.save({"part": {"weight": torch.arange(3.0)}, "epoch": 7}, tmp_path / "a.pt")
    content = load_weights(tmp_path / "a.pt")
    assert content["epoch"] == 7
    assert torch.equal(content["part"]["weight"], torch.arange(3.0))


def test_nothing_in_a_file_is_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    torch.save({"part": Runs()}, tmp_path / "a.pt")
    with pytest.raises(ValueError, match="without running code"):
        load_weights(tmp_path / "a.pt")
    assert capsys.readouterr().out == ""


def test_what_is_no_list_of_weights_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="check the path"):
        load_weights(tmp_path / "gone.pt")
    (tmp_path / "b.pt").write_bytes(b"not weights")
    with pytest.raises(ValueError, match="fetch it again"):
        load_weights(tmp_path / "b.pt")
    (tmp_path / "b.safetensors").write_bytes(b"not weights")
    with pytest.raises(ValueError, match="fetch it again"):
        load_weights(tmp_path / "b.safetensors")
    torch.save(torch.ones(2), tmp_path / "c.pt")
    with pytest.raises(ValueError, match="dictionary of weights"):
        load_weights(tmp_path / "c.pt")
