import numpy as np
import pytest
import torch

from lagsplat.io.files.artifact import restore_module


def test_weights_come_back_and_those_of_another_layout_are_refused_by_name() -> None:
    module = torch.nn.Linear(2, 3)
    tensors = {name: value.detach().numpy() for name, value in torch.nn.Linear(2, 3).state_dict().items()}
    back = restore_module(module, tensors, "a.safetensors")
    assert not back.training
    np.testing.assert_array_equal(back.weight.detach().numpy(), tensors["weight"])
    with pytest.raises(ValueError, match=r"a\.safetensors.*bias.*make it again"):
        restore_module(module, tensors | {"bias": np.zeros((3, 1), np.float32)}, "a.safetensors")
